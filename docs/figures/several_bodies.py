"""Draw `docs/images/several_bodies.png`: three bodies of different materials that fall on each other.

Run: python -m docs.figures.several_bodies
"""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
import trimesh

from docs.figures.gallery import knot
from physconvex.play import RestSurface, frames_of, load_play_config, play_together, summary_of

TARGET = Path(__file__).parents[1] / "images" / "several_bodies.png"
RESULT = Path(__file__).parents[1] / "results" / "data" / "several_bodies.json"
COMMON = ("basis.modes=8", "basis.max_nodes=300", "object.drop_height=0.1", "time.frames=19")
OBJECTS = {
    "box": ("object.size=0.6", "material.youngs_modulus=5.0e4", "object.drop_height=0.02"),
    "knot": ("object.size=0.4", "material.youngs_modulus=2.0e5", "material.damping_time=5.0e-3"),
    "ball": ("object.size=0.25", "material.youngs_modulus=3.0e4", "material.density=500"),
}
SHOWN = (0, 5, 10, 18)


def surfaces() -> list[RestSurface]:
    """A box, a ring with a ball on it, a ball."""
    box = trimesh.creation.box((0.6, 0.5, 0.2)).subdivide().subdivide()
    ball = trimesh.creation.icosphere(subdivisions=3)
    return [
        RestSurface(np.asarray(box.vertices), np.asarray(box.faces)),
        knot(),
        RestSurface(np.asarray(ball.vertices), np.asarray(ball.faces)),
    ]


def main() -> None:
    """Play and draw."""
    torch.set_num_threads(1)
    configs = [load_play_config(overrides=[*COMMON, *own]) for own in OBJECTS.values()]
    played = play_together(surfaces(), configs)
    figure, axes = plt.subplots(1, len(SHOWN), figsize=(7.2, 2.0))
    for axis, number, picture in zip(axes, SHOWN, frames_of(played, size=360, show=list(SHOWN)), strict=True):
        axis.imshow(picture)
        axis.set_title(f"{played.trajectory.times[number]:.2f} s", fontsize=7, pad=2)
        axis.set_axis_off()
    figure.tight_layout(pad=0.4)
    figure.savefig(TARGET, dpi=130)
    RESULT.write_text(json.dumps(summary_of(played), indent=1) + "\n")
    print(summary_of(played))


if __name__ == "__main__":
    main()
