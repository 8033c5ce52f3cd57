"""What the twin's mesh is worth: nodes, mesher, filled elements. Motion and estimates at the truth.

python benchmarks/twin_meshes.py BENCHMARK --names NAME …                (goes on where it stopped)

BENCHMARK is a folder of `physconvex generate benchmark`. Each object is rolled out at its true E, ν and damping on
meshes of few and more nodes (*best*: of several meshers, as those of `refine`'s last searches), as they are and filled
(`physconvex.mesh.filled`). *Distance*: rms from the truth's points by
frame [mm]. *Shift*: where E [decades] and ν would go if fitted to those points, to first order, frames counting by that
distance, with a prior of 0.33 decades of E and 0.17 of ν.

With `--best 1400 2400` only meshes of the best of several meshers with so many nodes are taken, and filled. With
`--reference 7000` all is told once more by another motion than the truth's: of the best filled mesh with at most so
many nodes, and half the time step; and where the values would go from the truth's own points.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from inference import with_rest_geometry
from physconvex.fem import SurfacePoints
from physconvex.identify import FullModel, Twin, TwinOptions, base_twin
from physconvex.io import load_capture
from physconvex.mesh import TetMesh, filled, overlap, tetrahedralize
from physconvex.reduced import parameter_values

RESULTS = Path(__file__).parent / "results"
MESHES = ((500, "auto"), (900, "auto"), (900, "simplified"), (1400, "best"))
Meshes = Sequence[tuple[int, str]]
Surface = tuple[np.ndarray, np.ndarray]  # vertices and triangles
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


@dataclass(frozen=True, eq=False)
class Target:
    """Motions to be fitted: positions of the points `rest` [P, 3] m, by name, each [T, P, 3] m."""

    rest: np.ndarray
    motions: dict[str, np.ndarray]


def told(here: np.ndarray, tangents: np.ndarray, target: np.ndarray) -> dict[str, Any]:
    """Distance from a motion, and where the values would go."""
    away = np.sqrt(np.square(here - target).sum(-1).mean(1))
    return {
        "distance_mm": [round(1e3 * float(d), 1) for d in away],
        "shift": dict(zip(NAMES, shifts(here, tangents, target).round(4).tolist(), strict=True)),
    }


def judged(twin: Twin, mesh: TetMesh, surface: SurfacePoints, target: Target) -> dict[str, Any]:
    """One mesh."""
    clock = time.process_time()
    model = FullModel(twin, NAMES, target.rest, FRAMES, surface=surface, mesh=mesh)
    here, tangents = model.linearise(parameter_values(twin.scene, NAMES))
    out = told(here, tangents, target.motions["truth"])
    if "reference" in target.motions:
        reference = target.motions["reference"]
        out["to_reference"] = told(here, tangents, reference)
        out["truth_to_reference"] = told(target.motions["truth"], tangents, reference)
    return out | {"process_seconds": round(time.process_time() - clock, 1)}


def mesh_of(surface: Surface, nodes: int, way: str) -> TetMesh:
    """With at most so many nodes."""
    how: dict[str, Any] = {"method": "auto", "thorough": True} if way == "best" else {"method": way}
    return tetrahedralize(surface, max_nodes=nodes, order=2, **how)


def rows_of(folder: Path, name: str, meshes: Meshes, labels: Sequence[str], nodes_there: int) -> list[dict[str, Any]]:
    """All meshes of one object, as they are ("full") or filled, beside a reference of so many nodes if any."""
    stated = json.loads((folder / "truth" / name / "truth.json").read_text(encoding="utf-8"))
    with np.load(folder / "truth" / name / "points.npz", allow_pickle=False) as archive:
        rest, truth = archive["rest"], archive["positions"][:FRAMES]
    capture = with_rest_geometry(load_capture(folder / "captures" / name), body=folder / "truth" / name / "mesh.ply")
    twin = base_twin(capture, TwinOptions(weights=4, steps_per_frame=STEPS))
    true = [np.log10(stated["youngs_modulus"]), stated["poisson_ratio"], stated["damping_time"]]
    twin = twin.with_values(NAMES, np.array(true))
    surface, points = twin.surface, SurfacePoints.of_triangles(*twin.surface)
    target, rows = Target(rest, {"truth": truth}), []
    if nodes_there:
        finest = filled(mesh_of(surface, nodes_there, "best"), *surface)
        model = FullModel(twin, NAMES, rest, FRAMES, refinement=2, surface=points, mesh=finest)
        target.motions["reference"] = model.positions(parameter_values(twin.scene, NAMES))
    for nodes, way in meshes:
        mesh = mesh_of(surface, nodes, way)
        row: dict[str, Any] = {"asked_for": nodes, "way": way, "nodes": len(mesh.vertices)}
        row["overlap"] = round(overlap(mesh, *surface), 3)
        row |= {"reference_nodes": len(finest.vertices)} if nodes_there else {}
        for label in labels:
            grid = filled(mesh, *surface) if label == "filled" else replace(mesh, filling=None)
            row[label] = judged(twin, grid, points, target)
        print(name, row, flush=True)
        rows.append(row)
    return rows


def mean(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of the absolute shifts, and (geometric) of the distances after the landing."""
    out: dict[str, Any] = {name: round(float(np.mean([abs(r["shift"][name]) for r in rows])), 4) for name in NAMES[:2]}
    late = np.array([r["distance_mm"][-4:] for r in rows])
    out["distance_mm"] = round(float(np.exp(np.log(late).mean())), 1)
    further = ("to_reference", "truth_to_reference")
    return out | {name: mean([r[name] for r in rows]) for name in further if name in rows[0]}


def means(objects: dict[str, list[dict[str, Any]]], meshes: Meshes, labels: Sequence[str]) -> dict[str, Any]:
    """By mesh, over the objects."""
    out: dict[str, Any] = {}
    for place, (nodes, way) in enumerate(meshes):
        rows = [every[place] for every in objects.values()]
        out[f"{nodes} {way}"] = {label: mean([row[label] for row in rows]) for label in labels}
    return out


def main() -> None:
    """Run what is missing, and store it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("benchmark", type=Path)
    parser.add_argument("--names", nargs="+", required=True)
    parser.add_argument("--best", nargs="+", type=int)
    parser.add_argument("--reference", type=int, default=0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    meshes: Meshes = [(nodes, "best") for nodes in given.best] if given.best else MESHES
    labels = ("filled",) if given.best else ("full", "filled")
    out = given.out or RESULTS / ("twin_meshes_reference.json" if given.best else "twin_meshes.json")
    known = json.loads(out.read_text(encoding="utf-8")) if out.exists() else {"objects": {}}
    for name in given.names:
        if name not in known["objects"]:
            known["objects"][name] = rows_of(given.benchmark, name, meshes, labels, given.reference)
            command = "python benchmarks/twin_meshes.py BENCHMARK --names " + " ".join(known["objects"])
            command += f" --best {' '.join(map(str, given.best))}" if given.best else ""
            command += f" --reference {given.reference}" if given.reference else ""
            known |= {"command": command, "means": means(known["objects"], meshes, labels)}
            out.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
