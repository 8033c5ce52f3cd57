"""How much of a scanned body its meshes of few nodes are, by mesher, and what that does to a drop.

python benchmarks/mesh_overlap.py --objects FOLDER                (goes on where it stopped)

FOLDER holds folders, each with a textured mesh (Google Scanned Objects). Overlap is the volume that mesh and body have
in common over that of both together; "centre" is how far the mesh's centre of mass lies from the body's, in sizes. For
the object named by --drop, roll-outs of 500 nodes are compared with those of 1,500 of the same and of the other mesher:
rms distance of the surface by frame [mm], body of 1 m.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from data_gen import BenchmarkMotion, ObjectMesh, load_user_mesh, objects_from_folder, placed, rolled, scene_of
from physconvex import ConvergenceError
from physconvex.mesh import Embedding, TetMesh, overlap, tetrahedralize, with_merged_vertices

RESULT = Path(__file__).parent / "results" / "mesh_overlap.json"
NODES = (500, 1500)
WAYS = ("lattice", "best")  # the latter: the best of lattice, fTetWild and simplified surface
TRUTH = {"youngs_modulus": 5e5, "poisson_ratio": 0.35, "damping_time": 1e-3}
FRAMES, FPS, STEPS, POINTS = 16, 24.0, 16, 300


def centre(vertices: np.ndarray, simplices: np.ndarray) -> np.ndarray:
    """Centre of mass [m] of tetrahedra, or of what a closed surface encloses."""
    x = vertices[simplices]
    if x.shape[1] == 3:
        x = np.concatenate([x, np.broadcast_to(vertices.mean(axis=0), (len(x), 1, 3))], axis=1)
        volume = np.linalg.det(x[:, :3] - x[:, 3:])
    else:
        volume = np.linalg.det(x[:, 1:] - x[:, :1])
    return np.asarray((volume[:, None] * x.mean(axis=1)).sum(axis=0) / volume.sum())


def meshed(body: ObjectMesh, way: str, nodes: int) -> TetMesh:
    """Quadratic tetrahedra of a body."""
    surface = (body.vertices, body.faces)
    if way == "lattice":
        return tetrahedralize(surface, method="lattice", max_nodes=nodes, order=2)
    return tetrahedralize(surface, method="auto", max_nodes=nodes, order=2, thorough=True)


def judged(body: ObjectMesh, way: str, nodes: int) -> dict[str, Any]:
    """One mesh: its nodes, overlap, centre, seconds; or why there is none."""
    clock = time.perf_counter()
    try:
        mesh = meshed(body, way, nodes)
    except ConvergenceError as error:
        return {"failure": str(error).split(";")[0]}
    seconds = time.perf_counter() - clock
    surface = with_merged_vertices(body.vertices, body.faces)
    away = np.linalg.norm(centre(mesh.vertices, mesh.corner_tets) - centre(*surface)) / np.ptp(surface[0], axis=0).max()
    return {
        "nodes": len(mesh.vertices),
        "overlap": round(overlap(mesh, body.vertices, body.faces), 3),
        "centre": round(float(away), 4),
        "seconds": round(seconds, 1),
    }


def dropped(body: ObjectMesh) -> dict[str, list[float]]:
    """Rms distances [mm] between roll-outs on the meshes of all ways, by frame."""
    chosen = np.random.default_rng(0).choice(len(body.vertices), POINTS, replace=False)
    moved = {}
    for way in WAYS:
        for nodes in NODES:
            mesh = meshed(body, way, nodes)
            nodal = rolled(scene_of(mesh, TRUTH, body, BenchmarkMotion()), FRAMES, FPS, STEPS)
            moved[f"{way} {nodes}"] = Embedding.of_points(mesh, body.vertices[chosen]).apply(nodal)
            print(f"  {way} {nodes}: {len(mesh.vertices)} nodes", file=sys.stderr, flush=True)
    return {
        f"{a} to {b}": [round(1e3 * float(d), 1) for d in np.sqrt(np.square(moved[a] - moved[b]).sum(-1).mean(-1))]
        for a, b in combinations(moved, 2)
    }


def main() -> None:
    """Judge all objects, drop one, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--names", nargs="+", help="of the folders; default: all")
    parser.add_argument("--drop", default="Schleich_Lion_Action_Figure")
    parser.add_argument("--result", type=Path, default=RESULT)
    given = parser.parse_args()
    chosen = f" --names {shlex.join(given.names)}" if given.names else ""
    command = f"python benchmarks/mesh_overlap.py --objects FOLDER{chosen} --drop {shlex.quote(given.drop)}"
    out: dict[str, Any] = {"command": command, "objects": {}, "drop": {}}
    if given.result.exists():
        out = json.loads(given.result.read_text(encoding="utf-8"))

    def store() -> None:
        given.result.write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")

    for path in objects_from_folder(given.objects):
        if given.names and path.parent.name not in given.names:
            continue
        rows = out["objects"].setdefault(path.parent.name, {})
        body = placed(load_user_mesh(path), 1.0, np.random.default_rng(3))
        for way in WAYS:
            for nodes in NODES:
                if f"{way} {nodes}" not in rows:
                    rows[f"{way} {nodes}"] = judged(body, way, nodes)
                    print(path.parent.name, way, nodes, rows[f"{way} {nodes}"], file=sys.stderr, flush=True)
                    store()
        if path.parent.name == given.drop and not out["drop"]:
            out["drop"] = {"object": given.drop, **TRUTH, "rms_mm": dropped(body)}
            store()


if __name__ == "__main__":
    main()
