"""Skinning weights compared: how far a reduced body with each of them moves from the full model.

python benchmarks/reduced_bases.py

Two bodies on meshes of quadratic tetrahedra, dropped on a tilted floor: a cube of one material, and a bar one half of
which is 30 times stiffer. Snapshot modes are made of the motion of a body half as stiff, not of the one they are
compared with. The untrained field is the network of the neural field before its training, the mean over three seeds.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import TetMesh, box_mesh
from physconvex.reduced import (
    BodySamples,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    WeightField,
    eigenmode_weights,
    snapshot_weights,
    train_neural_weights,
    untrained_neural_weights,
)

RESULT = Path(__file__).parent / "results" / "reduced_bases.json"
FLOOR = Plane(point=(0, 0, -0.05), normal=(0.15, 0.05, 1.0), friction=0.3)
TIMING = Timing(frames=10, fps=48.0, steps_per_frame=4)
POISSON, SEEDS = 0.35, 3


@dataclass(frozen=True)
class Row:
    """Body, weights and their number: rms distance over nodes and frames [m], seconds to make the weights."""

    body: str
    weights: str
    count: int
    rms: float
    seconds: float


def bodies() -> Iterator[tuple[str, TetMesh, np.ndarray]]:
    """Name, mesh and E per tetrahedron [Pa]."""
    cube = box_mesh((0.2, 0.2, 0.2), (2, 2, 2), order=2)
    yield "cube", cube, np.full(len(cube.tets), 3e4)
    bar = box_mesh((0.4, 0.1, 0.1), (4, 1, 1), order=2)
    left = bar.vertices[bar.corner_tets].mean(1)[:, 0] < 0.2
    yield "half-stiff bar", bar, np.where(left, 9e5, 3e4)


def full_motion(mesh: TetMesh, modulus: np.ndarray) -> np.ndarray:
    """Positions of the nodes at the frames [m]."""
    body = ElasticBody(mesh, youngs_modulus=modulus, poisson_ratio=POISSON)
    return simulate(Scene(body, obstacles=(FLOOR,)), TIMING).positions


def distance(mesh: TetMesh, modulus: np.ndarray, field: WeightField, full: np.ndarray) -> float:
    """Root mean square over nodes and frames [m]."""
    body = ReducedBody(ReducedSpace(field, BodySamples.of_mesh(mesh)), youngs_modulus=modulus, poisson_ratio=POISSON)
    moved = simulate(ReducedScene(body, obstacles=(FLOOR,)), TIMING).positions(mesh.vertices)
    return float(np.sqrt(((moved - full) ** 2).sum(-1).mean()))


def fields(mesh: TetMesh, modulus: np.ndarray, count: int, softer: np.ndarray) -> Iterator[tuple[str, WeightField]]:
    """The weights that are compared."""
    body, samples = ElasticBody(mesh, youngs_modulus=modulus, poisson_ratio=POISSON), BodySamples.of_mesh(mesh)
    yield "eigenmodes", eigenmode_weights(body, count)
    yield "snapshots", snapshot_weights(body, [softer - mesh.vertices], count)
    generator = torch.Generator().manual_seed(0)
    yield "neural", train_neural_weights(samples, count, generator=generator, youngs_modulus=modulus)
    for seed in range(SEEDS):
        yield "untrained", untrained_neural_weights(samples, count, generator=torch.Generator().manual_seed(seed))


def main() -> None:
    """Run all settings and store the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    torch.set_num_threads(1)
    rows = []
    for name, mesh, modulus in bodies():
        full, softer = full_motion(mesh, modulus), full_motion(mesh, modulus / 2)
        for count in (3, 10):
            found: dict[str, list[tuple[float, float]]] = {}
            clock = time.process_time()
            for weights, field in fields(mesh, modulus, count, softer):
                seconds = time.process_time() - clock
                found.setdefault(weights, []).append((distance(mesh, modulus, field, full), seconds))
                clock = time.process_time()
            for weights, values in found.items():
                rms, seconds = np.mean(values, axis=0).tolist()
                rows.append(Row(name, weights, count, rms, seconds))
                print(rows[-1], flush=True)
    RESULT.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
