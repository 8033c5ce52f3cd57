"""What errors of a reconstructed body do to E and ν, and whether the stated geometry error tells them.

python benchmarks/body_error.py --work FOLDER [--names NAME …]                 (goes on where it stopped)

FOLDER is that of `benchmarks/reconstruction.py --work`: captures of scanned objects, and the bodies reconstructed from
12 pictures. Each body falls on a floor (E of 40 times the pressure of its weight, ν = 0.35, friction 0.4) and is rolled
out on a mesh of few nodes: as reconstructed, with its surface displaced to the scan's, and displaced by one standard
deviation of each part of its error (`physconvex.reconstruction.surface_error`). *Shift*: where log10 E and ν go that
are fitted, to first order, to the motion of 60 points of the scan's body, with a prior of 0.33 decades and 0.17,
beside the damping and, as in `refine`, the floor's height within the error of the body. *Held*: with that height held.
*Sigma*: the geometry error that `refine` states, by the same points. *Common*, *local*, *unseen*: of the surface's
distance from the scan, the offset that has the volume's error, the rms about it where two pictures show it, and the rms
elsewhere, each over the stated deviation.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

from inference import capture_views
from inference.refinement.geometry_error import displaced, parameter_errors
from physconvex.fem import SurfacePoints
from physconvex.identify import (
    Fit,
    FitOptions,
    FullModel,
    LinearModel,
    MarkerObservations,
    TwinOptions,
    base_twin,
    default_parameter,
    fit,
    parameter_shift,
)
from physconvex.io import Capture, Floor, load_capture, read_mesh
from physconvex.mesh import enclosed_volume, surface_distance, with_merged_vertices
from physconvex.reconstruction import SurfaceError, surface_error

RESULTS = Path(__file__).parent / "results" / "body_error.json"
NAMES = ("log10_youngs_modulus", "poisson_ratio", "damping_time", "floor_height")
FRAMES, FPS, STEPS, POINTS, NOISE = 14, 48.0, 12, 60, 3e-3  # noise: of the size
PRIORS = {"log10_youngs_modulus": 0.33, "poisson_ratio": 0.17, "damping_time": 3e-3}


def measure(name: str, work: Path) -> dict[str, Any] | None:
    """One object; None where its scan is not closed."""
    source = load_capture(work / f"{name}-448")
    held = [camera.name for camera in source.cameras if camera.name.startswith("held")]
    scan = source.mesh()
    assert scan is not None
    vertices, faces = with_merged_vertices(np.asarray(scan.vertices, dtype=np.float64), np.asarray(scan.faces))
    volume = enclosed_volume(vertices, faces)
    if volume is None:
        return None
    body = read_mesh(work / f"{name}-448-result" / "body.ply")
    views = capture_views(source, held).training
    error = surface_error(body, views)
    beyond = surface_distance(vertices, faces)(np.asarray(body.vertices))
    row = surface_row(body, error, beyond, volume)
    return row | motion_row(body, error, beyond)


def surface_row(body: trimesh.Trimesh, error: SurfaceError, beyond: np.ndarray, volume: float) -> dict[str, Any]:
    """The distances from the scan over the stated deviations."""
    known, areas = error.unseen == 0, error.areas
    offset = float((body.volume - volume) / areas.sum())
    return {
        "volume": body.volume / volume - 1,
        "common": offset / error.common,
        "local": rms(beyond[known] - offset, areas[known]) / error.local,
        "unseen": rms(beyond[~known], areas[~known]) / rms(error.unseen[~known], areas[~known]),
        "unseen_share": error.unseen_share,
    }


def rms(values: np.ndarray, weights: np.ndarray) -> float:
    """Weighted root mean square."""
    return float(np.sqrt((weights * values**2).sum() / weights.sum()))


def motion_row(body: trimesh.Trimesh, error: SurfaceError, beyond: np.ndarray) -> dict[str, Any]:
    """Where a fit to the motion of the scan's body goes, and the stated errors."""
    clock = time.process_time()
    size, low = float(body.extents.max()), float(body.bounds[0, 2])
    # the fall takes a third of the frames
    height = 0.5 * 9.81 * (0.3 * FRAMES / FPS) ** 2
    floor = Floor(np.array([0, 0, low - height]), np.array([0, 0, 1.0]), 0.4)
    capture = Capture(Path(), FPS, FRAMES, FRAMES, floor=floor, body=body, initial_velocity=np.zeros(3),
                      initial_angular_velocity=np.zeros(3))  # fmt: skip
    twin = base_twin(capture, TwinOptions(weights=4, max_nodes=500, steps_per_frame=STEPS, fill=True))
    true = np.array([np.log10(40 * capture.density * 9.81 * size), 0.35, 1e-3, low - height])
    twin = twin.with_values(NAMES, true)
    points, _ = trimesh.sample.sample_surface(body, POINTS, seed=0)
    surface = SurfacePoints.of_triangles(*twin.surface)
    model = FullModel(twin, NAMES, points, FRAMES, surface=surface)
    here, tangents = model.linearise(true)
    seen = MarkerObservations(points, here, np.full(here.shape[:2], NOISE * size))
    priors = PRIORS | {"floor_height": error.deviation}
    parameters = [
        replace(default_parameter(name), prior_mean=value, prior_sigma=priors[name]).at(value)
        for name, value in zip(NAMES, true.tolist(), strict=True)
    ]

    def fitted(count: int) -> Fit:
        linear = LinearModel(NAMES[:count], true[:count], here, tangents[:, :count])
        return fit(linear, seen, parameters[:count], options=FitOptions(max_iterations=1))

    found = fitted(len(NAMES))
    base, there = (displaced(model, body, by).positions(true) for by in (np.zeros_like(beyond), -beyond))
    change = seen.residuals(base) - seen.residuals(there)  # the scan's motion is observed, the body's fitted
    parts = parameter_errors(model, found, seen, body, error)
    return {
        "shift": named(parameter_shift(found, change)),
        "held": named(parameter_shift(fitted(len(NAMES) - 1), change)),
        "sigma": named(np.sqrt(np.square(parts).sum(axis=0))),
        "parts": [named(part) for part in parts],
        "away": [round(float(v), 5) for v in np.sqrt(np.square(base - there).sum(-1).mean(1)) / size],
        "seconds": round(time.process_time() - clock, 1),
    }


def named(values: np.ndarray) -> dict[str, float]:
    """By parameter."""
    return dict(zip(NAMES, values.round(4).tolist(), strict=False))


def means(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Root mean squares over the objects: of shifts, of sigmas, and of their ratios."""
    out: dict[str, Any] = {}
    for name in NAMES[:2]:
        shift, sigma = (np.array([row[what][name] for row in rows]) for what in ("shift", "sigma"))
        within = float((np.abs(shift) <= 1.645 * sigma).mean())
        out[name] = {"shift": root(shift), "sigma": root(sigma), "ratio": root(shift / sigma), "within_90": within}
        out[name]["held"] = root(np.array([row["held"][name] for row in rows]))
    return out | {name: root(np.array([row[name] for row in rows])) for name in ("volume", "common", "local", "unseen")}


def root(values: np.ndarray) -> float:
    """Root mean square."""
    return round(float(np.sqrt(np.mean(values**2))), 4)


def main() -> None:
    """Measure what is missing, and store it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--names", nargs="*")
    parser.add_argument("--no-store", action="store_true")
    given = parser.parse_args()
    torch.set_num_threads(1)
    found = sorted(path.parent.name.removesuffix("-448-result") for path in given.work.glob("*-448-result/body.ply"))
    known = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {"objects": {}}
    for name in given.names or found:
        row = known["objects"].get(name) or measure(name, given.work)
        if row is None:
            continue
        print(name, json.dumps(row), flush=True)
        known["objects"][name] = row
        rows = list(known["objects"].values())
        known |= {"command": "python benchmarks/body_error.py --work FOLDER", "means": means(rows)}
        if not given.no_store:
            RESULTS.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
