"""Static reconstruction of scanned objects: views that were fitted, views that were not, time, memory, coverage.

Each object (a folder with model.obj and texture.png) is rendered at 448² from 12 cameras to fit (elevations 10, 35 and
−10 degrees in turn) and 4 held out between them (20 and 0 degrees), with alpha, before white; then reconstructed from
them and its mesh. Coverage is measured against the mesh, where that is watertight; `margin` is half of what a pixel
covers. The body's closed surface is compared with the mesh, beside the visual hull of the same silhouettes. Processor
time counts all threads. Rows of other objects from runs with the same settings are kept.

Starts that know less than the mesh: `--set start=hull` (the visual hull of the silhouettes), and `--set start=points
--points 20000`: so many random points of the surface, each off by one pixel's footprint (normal, each coordinate), as
structure from motion gives them.

python benchmarks/reconstruction.py --objects data/gso [--names Dino_4 …] [--size 448] [--threads 2] [--set steps=120]
    [--result _hull]
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

from data_gen import StillViews, load_user_mesh, write_still_capture
from inference import Reconstruction, ReconstructOptions, capture_views, reconstruct
from physconvex import InputError
from physconvex.io import load_capture
from physconvex.mesh import enclosed_volume, surface_distance, with_merged_vertices
from physconvex.reconstruction import visual_hull
from train import Coverage, measure_coverage

RESULTS = Path(__file__).parent / "results"
VIEWS = (StillViews(12, (10, 35, -10), name="fit"), StillViews(4, (20, 0), phase=0.37, name="held"))


@dataclass(frozen=True)
class Surface:
    """A closed surface against the mesh: relative error of the volume, and distances over the mesh's longest edge.

    `distance` is the mean from the surface to the mesh and back, `farthest` the greatest from the mesh to it.
    """

    seconds: float
    volume: float
    distance: float
    farthest: float


@dataclass(frozen=True)
class Row:
    """One object: means over views, cost, coverage (None for a surface that is open).

    `wall_seconds` is that of the fit. `processor_seconds` includes scoring and files; None for a run that was resumed.
    """

    object: str
    start: str
    convexes: int
    training_psnr: float
    training_ssim: float
    held_out_psnr: float
    held_out_psnr_object: float
    held_out_ssim: float
    held_out_mask_iou: float
    wall_seconds: float
    processor_seconds: float | None
    peak_memory_mib: float
    coverage: Coverage | None
    surface: Surface | None
    hull: Surface | None


def measure(name: str, folder: Path, work: Path, options: argparse.Namespace) -> Row:
    """Render, reconstruct and score one object."""
    capture = work / f"{name}-{options.size}"
    if not capture.exists():
        write_still_capture(capture, load_user_mesh(folder / name / "model.obj"), VIEWS, size=options.size)
    held_out = [f"{VIEWS[1].name}{k}" for k in range(VIEWS[1].count)]
    processor = time.process_time()
    out = work / f"{name}-{options.size}-result"
    points = cloud(capture, options.points, work / f"{name}-{options.points}.ply") if options.points else None
    settings = ReconstructOptions(settings=options.settings, held_out=held_out, points=points)
    result = reconstruct(capture, out=out, options=settings, redo=not options.resume)
    spent = None if options.resume else time.process_time() - processor
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    numbers = result.to_json()
    training, held = numbers["training"]["mean"], numbers["held_out"]["mean"]
    clock = time.perf_counter()
    hull = visual_hull(capture_views(load_capture(capture), held_out).training)
    hull_seconds = time.perf_counter() - clock
    return Row(
        name, result.start, len(result.field), training["psnr"], training["ssim"], held["psnr"], held["psnr_object"],
        held["ssim"], held["mask_iou"], result.seconds, spent, memory, coverage(result, capture),
        surface_of(result.body, capture, result.body_seconds), surface_of(hull, capture, hull_seconds),
    )  # fmt: skip


def mesh_and_pixel(capture: Path) -> tuple[trimesh.Trimesh, float]:
    """The capture's mesh, and what a pixel covers at its middle [m]."""
    source = load_capture(capture)
    mesh = source.mesh()
    assert mesh is not None
    camera = source.cameras[0]
    return mesh, float(np.linalg.norm(camera.position - mesh.bounds.mean(axis=0))) / camera.fl_x


def surface_of(body: trimesh.Trimesh | None, capture: Path, seconds: float) -> Surface | None:
    """A surface against the capture's mesh; None without either as a closed one."""
    mesh, _ = mesh_and_pixel(capture)
    vertices, faces = with_merged_vertices(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces))
    volume = enclosed_volume(vertices, faces)
    if body is None or volume is None:
        return None
    there, back = (trimesh.sample.sample_surface(one, 20_000, seed=0)[0] for one in (body, mesh))
    ours = np.abs(surface_distance(np.asarray(body.vertices), np.asarray(body.faces))(back))
    theirs = np.abs(surface_distance(vertices, faces)(there))
    size = float(np.ptp(vertices, axis=0).max())
    distance = 0.5 * (ours.mean() + theirs.mean()) / size
    return Surface(seconds, float(body.volume / volume - 1), float(distance), float(ours.max() / size))


def cloud(capture: Path, count: int, path: Path) -> Path:
    """A file of random points near the surface."""
    mesh, pixel = mesh_and_pixel(capture)
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=0)
    trimesh.PointCloud(points + pixel * np.random.default_rng(0).standard_normal(points.shape)).export(path)
    return path


def coverage(result: Reconstruction, capture: Path) -> Coverage | None:
    """Coverage of the capture's mesh."""
    mesh, pixel = mesh_and_pixel(capture)
    try:
        return measure_coverage(result.field, mesh, margin=0.5 * pixel)
    except InputError:
        return None


def stored_rows(result: Path, command: str, names: list[str]) -> list[dict[str, Any]]:
    """Rows of other objects that the same command (but for the names) has stored in a result file."""
    if not result.exists():
        return []
    content = json.loads(result.read_text())
    return [row for row in content["rows"] if row["object"] not in names] if content["command"] == command else []


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True, help="folder of folders with model.obj and texture.png")
    parser.add_argument("--names", nargs="*", help="which of them; all if not given")
    parser.add_argument("--size", type=int, default=448)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--set", dest="settings", nargs="*", default=[], help="settings, as steps=120")
    parser.add_argument("--points", type=int, default=0, help="random points of the surface to start from")
    parser.add_argument("--result", default="", help="added to the name of the result file")
    parser.add_argument("--work", type=Path, help="folder for captures and fields; kept if given")
    parser.add_argument("--resume", action="store_true", help="go on where an earlier run in --work was stopped")
    parser.add_argument("--no-store", action="store_true", help="only print")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    names = options.names or sorted(path.parent.name for path in options.objects.glob("*/model.obj"))
    command = f"python benchmarks/reconstruction.py --objects gso --size {options.size} --threads {options.threads}"
    command += f" --set {' '.join(options.settings)}" if options.settings else ""
    command += f" --points {options.points}" if options.points else ""
    command += f" --result {options.result}" if options.result else ""
    stored = RESULTS / f"reconstruction{options.result}.json"
    rows = [] if options.no_store else stored_rows(stored, command, names)
    with tempfile.TemporaryDirectory() as scratch:
        for name in names:
            row = measure(name, options.objects, options.work or Path(scratch), options)
            rows.append(asdict(row))
            print(row, flush=True)
            if not options.no_store:
                stored.write_text(json.dumps({"command": command, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
