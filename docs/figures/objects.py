"""Draw `docs/images/objects.png`: random objects with random solid textures, one row per family.

Run: python docs/figures/objects.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista
from PIL import Image

from data_gen import FAMILIES, random_object, vertex_colors

COLUMNS, TILE = 6, 200
TARGET = Path(__file__).parents[1] / "images" / "objects.png"


def tile(plotter: pyvista.Plotter, family: str, seed: int) -> np.ndarray:
    """Picture [H, W, 3] of one object."""
    rng = np.random.default_rng([seed, sorted(FAMILIES).index(family)])
    body = random_object(rng, families=[family], triangles=12000)
    mesh = pyvista.PolyData.from_regular_faces(body.vertices, body.faces)
    mesh.point_data["colors"] = vertex_colors(body.vertices, rng)
    plotter.clear_actors()
    plotter.add_mesh(mesh, scalars="colors", rgb=True, smooth_shading=True, specular=0.2)
    plotter.camera_position = [(1.6, -1.9, 1.2), (0, 0, 0), (0, 0, 1)]
    plotter.camera.view_angle = 28
    return np.asarray(plotter.screenshot(return_img=True))[..., :3]


def main() -> None:
    plotter = pyvista.Plotter(off_screen=True, window_size=(TILE, TILE), lighting="three lights")
    plotter.set_background("white")
    rows = [np.hstack([tile(plotter, family, seed) for seed in range(COLUMNS)]) for family in FAMILIES]
    plotter.close()
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(rows)).quantize(256).save(TARGET, optimize=True)
    print(f"{TARGET}: {TARGET.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
