"""Draw `docs/images/gallery.png`: the presets of `physconvex simulate`, each at four times.

Run: python -m docs.figures.gallery --mesh MESH      (any closed mesh, z up; a knot unless given)
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch

from physconvex.play import PlayedObject, RestSurface, frames_of, load_play_config, play, read_surface, summary_of

TARGET = Path(__file__).parents[1] / "images" / "gallery.png"
RESULT = Path(__file__).parents[1] / "results" / "data" / "gallery.json"
PRESETS = {
    "stiff": "E = 10 MPa, ν = 0.49",
    "soft": "E = 8 kPa, ν = 0.4",
    "plasticine": "yields at 500 Pa",
    "sand": "friction angle 10°",
    "push": "pushed to the left",
    "moving_floor": "floor to and fro",
}
SETTINGS = ("object.size=0.5", "basis.modes=10")
COLUMNS = 4


def knot() -> RestSurface:
    """A thick torus with a ball on one side: round, and not the same from all sides."""
    import trimesh

    ring = trimesh.creation.torus(major_radius=0.16, minor_radius=0.075, major_sections=48, minor_sections=24)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.11)
    ball.apply_translation([0.16, 0.0, 0.06])
    both = trimesh.boolean.union([ring, ball], engine="manifold")
    return RestSurface(np.asarray(both.vertices), np.asarray(both.faces))


def row(played: PlayedObject, axes: np.ndarray) -> None:
    """Pictures at equal distances in time."""
    show = np.linspace(0, len(played.positions) - 1, COLUMNS + 1).round().astype(int)[1:]
    for axis, number, picture in zip(axes, show, frames_of(played, size=360, show=show.tolist()), strict=True):
        axis.imshow(picture)
        axis.set_title(f"{played.trajectory.times[number]:.2f} s", fontsize=7, pad=2)


def main() -> None:
    """Play and draw all presets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", type=Path)
    parser.add_argument("--turn", type=float, nargs=3, default=(70.0, 15.0, 0.0), help="turns about x, y, z [degrees]")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    surface = knot() if arguments.mesh is None else read_surface(arguments.mesh)
    figure, axes = plt.subplots(len(PRESETS), COLUMNS, figsize=(7.2, 1.85 * len(PRESETS)))
    summaries = {}
    for (name, caption), line in zip(PRESETS.items(), axes, strict=True):
        turn = f"object.orientation_deg={json.dumps(list(arguments.turn))}"
        played = play(surface, load_play_config(name, overrides=[*SETTINGS, turn]))
        row(played, line)
        line[0].text(-0.13, 0.5, f"{name}\n{caption}", fontsize=7, rotation=90, ha="center", va="center",
                     transform=line[0].transAxes)  # fmt: skip
        summaries[name] = summary_of(played)
        print(name, summaries[name], flush=True)
    for axis in axes.flat:
        axis.set_axis_off()
    figure.tight_layout(pad=0.4)
    figure.savefig(TARGET, dpi=130)
    RESULT.write_text(json.dumps(summaries, indent=1) + "\n")


if __name__ == "__main__":
    main()
