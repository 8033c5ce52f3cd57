"""How near refinement comes to the truth from one film, and how often its 90 % intervals hold it.

python benchmarks/refine_images.py --cases 60          (goes on where it stopped)

Bars of 0.3 m that swing from a clamp, as in `refine_accuracy.py --coarse` (truth: 2,025 nodes and half the time step;
the model begins with 63 nodes), with random colours, filmed by one camera from in front (256², turned by up to 25
degrees, raised by 5 to 20) before white, each pixel with noise of two grey values of 255. 12 of 16 frames at 48 per
second are fitted from the film and its masks; E, ν and damping are unknown. The constant predictor says the middle of
both ranges.
"""

from __future__ import annotations

import argparse
import json
import shlex
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
import trimesh
from refine_accuracy import CELLS, COARSE, OPTIONS, RESULTS, Row, row_of, simulated, summary

from data_gen import FLAT, DrawnSurface, StillViews, rendered_frames, still_cameras, vertex_colors
from inference import refine
from physconvex.io import save_capture
from physconvex.mesh import Embedding

SIZE, NOISE, EDGE = 256, 2.0, 0.004  # [px], [of 255], [m] of the coloured triangles


def film(folder: Path, case: int) -> None:
    """Simulate the truth, film it and write the capture."""
    made = simulated("bar", case)
    vertices, faces = trimesh.remesh.subdivide_to_size(*made.fine.surface, max_edge=EDGE)
    moved = Embedding.of_points(made.mesh, vertices).apply(made.positions)
    turn, rise = made.rng.uniform(-25, 25) / 360 - 0.25, made.rng.uniform(5, 20)
    (camera,) = still_cameras(moved.reshape(-1, 3), StillViews(1, (rise,), turn, "front"), SIZE)
    surface = DrawnSurface(vertices, faces, colors=vertex_colors(vertices, made.rng))
    frames = np.stack(rendered_frames(surface, camera, FLAT, moved)).astype(np.float64)
    alpha = frames[..., 3:] / 255
    seen = frames[..., :3] * alpha + 255 * (1 - alpha)
    noisy = (seen + made.rng.normal(scale=NOISE, size=seen.shape)).round().clip(0, 255).astype(np.uint8)
    save_capture(
        made.capture(folder, cameras=(camera,)),
        videos={camera.name: noisy},
        masks={camera.name: alpha[..., 0] > 0.5},
        mesh=trimesh.Trimesh(vertices, faces, process=False),
        tets=made.coarse,
        boundary=made.held(),
        truth=made.truth,
        crf=6,
    )


def measure(root: Path, case: int) -> Row:
    """Make a capture unless it is there, refine it, compare."""
    folder = root / f"capture_{case:03d}"
    if not folder.exists():
        film(folder, case)
    truth = json.loads((folder / "truth.json").read_text())
    clock = time.process_time()
    found = refine(folder, out=root / f"refined_{case:03d}", options=OPTIONS.replace(field=False))
    return row_of(case, truth, found, time.process_time() - clock)


def main() -> None:
    """Run the cases that are not there yet, each kept in the work folder, and store the table of all."""
    torch.set_num_threads(1)
    CELLS.update(COARSE)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "refine_images")
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)
    for case in range(2 * given.first, 2 * given.cases, 2):  # the even cases of `refine_accuracy.py` are bars
        kept = given.work / f"row_{case:03d}.json"
        if not kept.exists():
            kept.write_text(json.dumps(asdict(measure(given.work, case))))
            print(kept.read_text(), flush=True)
    rows = [Row(**json.loads(path.read_text())) for path in sorted(given.work.glob("row_*.json"))]
    command = shlex.join(["python", "benchmarks/refine_images.py", f"--cases={given.cases}"])
    content = {"command": command, "summary": summary(rows), "rows": [asdict(row) for row in rows]}
    (RESULTS / "refine_images.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary(rows), indent=1))


if __name__ == "__main__":
    main()
