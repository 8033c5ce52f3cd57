"""What the twin's mesh is worth: nodes, mesher, filled elements. Motion and estimates at the truth.

python benchmarks/twin_meshes.py BENCHMARK --names NAME …                (goes on where it stopped)

BENCHMARK is a folder of `physconvex generate benchmark`. Each object is rolled out at its true E, ν and damping on
meshes of few and more nodes (*best*: of several meshers, as those of `refine`'s last searches), as they are and filled
(`physconvex.fem.filled`). *Distance*: rms from the truth's points by
frame [mm]. *Shift*: where E [decades] and ν would go if fitted to those points, to first order, frames counting by that
distance, with a prior of 0.33 decades of E and 0.17 of ν.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from physconvex.capture import load_capture
from physconvex.fem import SurfacePoints, TetMesh, filled, tetrahedralize
from physconvex.fem.surface_distance import overlap
from physconvex.identify import FullModel, Twin, TwinOptions, base_twin
from physconvex.reduced import parameter_values

RESULT = Path(__file__).parent / "results" / "twin_meshes.json"
MESHES = ((500, "auto"), (900, "auto"), (900, "simplified"), (1400, "best"))
NAMES = ("log10_youngs_modulus", "poisson_ratio", "damping_time")
FRAMES, STEPS, NOISE = 11, 16, 3e-3  # m
USUAL, PRIOR = np.array([0.1, 0.05, 1e-3]), 0.3  # changes, and one over the prior's width in them


def shifts(here: np.ndarray, tangents: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """To first order, where the values go that are fitted to the truth's points [T, P, 3] m from the model's."""
    away = np.sqrt(np.square(here - truth).sum(-1).mean(1))
    weight = 1 / np.hypot(NOISE, away)[:, None, None]
    slopes = np.moveaxis(tangents * weight[:, None], 1, -1).reshape(-1, len(USUAL)) * USUAL
    missed = ((truth - here) * weight).ravel()
    prior = PRIOR * np.sqrt(here.shape[1]) * np.eye(len(USUAL))
    rows, wanted = np.vstack([slopes, prior]), np.concatenate([missed, np.zeros(len(USUAL))])
    return np.asarray(np.linalg.lstsq(rows, wanted, rcond=None)[0] * USUAL)


def judged(twin: Twin, mesh: TetMesh, surface: SurfacePoints, rest: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    """One mesh."""
    values = parameter_values(twin.scene, NAMES)
    clock = time.process_time()
    here, tangents = FullModel(twin, NAMES, rest, FRAMES, surface=surface, mesh=mesh).linearise(values)
    away = np.sqrt(np.square(here - truth).sum(-1).mean(1))
    return {
        "distance_mm": [round(1e3 * float(d), 1) for d in away],
        "shift": dict(zip(NAMES, shifts(here, tangents, truth).round(4).tolist(), strict=True)),
        "process_seconds": round(time.process_time() - clock, 1),
    }


def rows_of(folder: Path, name: str) -> list[dict[str, Any]]:
    """All meshes of one object."""
    stated = json.loads((folder / "truth" / name / "truth.json").read_text(encoding="utf-8"))
    with np.load(folder / "truth" / name / "points.npz", allow_pickle=False) as archive:
        rest, truth = archive["rest"], archive["positions"][:FRAMES]
    twin = base_twin(load_capture(folder / "captures" / name), TwinOptions(weights=4, steps_per_frame=STEPS))
    true = [np.log10(stated["youngs_modulus"]), stated["poisson_ratio"], stated["damping_time"]]
    twin = twin.with_values(NAMES, np.array(true))
    surface, points = twin.surface, SurfacePoints.of_triangles(*twin.surface)
    rows = []
    for nodes, way in MESHES:
        how: dict[str, Any] = {"method": "auto", "thorough": True} if way == "best" else {"method": way}
        mesh = tetrahedralize(surface, max_nodes=nodes, order=2, **how)
        row: dict[str, Any] = {"asked_for": nodes, "way": way, "nodes": len(mesh.vertices)}
        row["overlap"] = round(overlap(mesh, *surface), 3)
        for label, grid in (("full", replace(mesh, filling=None)), ("filled", filled(mesh, *surface))):
            row[label] = judged(twin, grid, points, rest, truth)
        print(name, row, flush=True)
        rows.append(row)
    return rows


def mean(rows: list[dict[str, Any]], label: str) -> dict[str, float]:
    """Of the absolute shifts, and (geometric) of the distances after the landing."""
    out = {name: round(float(np.mean([abs(r[label]["shift"][name]) for r in rows])), 4) for name in NAMES[:2]}
    late = np.array([r[label]["distance_mm"][-4:] for r in rows])
    return out | {"distance_mm": round(float(np.exp(np.log(late).mean())), 1)}


def means(objects: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """By mesh, over the objects."""
    out: dict[str, Any] = {}
    for place, (nodes, way) in enumerate(MESHES):
        rows = [every[place] for every in objects.values()]
        out[f"{nodes} {way}"] = {label: mean(rows, label) for label in ("full", "filled")}
    return out


def main() -> None:
    """Run what is missing, and store it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("benchmark", type=Path)
    parser.add_argument("--names", nargs="+", required=True)
    parser.add_argument("--out", type=Path, default=RESULT)
    given = parser.parse_args()
    known = json.loads(given.out.read_text(encoding="utf-8")) if given.out.exists() else {"objects": {}}
    for name in given.names:
        if name not in known["objects"]:
            known["objects"][name] = rows_of(given.benchmark, name)
            told = "python benchmarks/twin_meshes.py BENCHMARK --names " + " ".join(known["objects"])
            known |= {"command": told, "means": means(known["objects"])}
            given.out.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
