"""How the reduced model's cost grows with weights, cubature points and bodies, and what its weights cost beforehand.

python benchmarks/reduced_scaling.py

Processor time on one core, float64; roll-outs of 24 frames of 8 steps on a smooth floor, boxes of 0.3 m and 100 kPa.
The neural field is timed on two threads, on the clock.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody
from physconvex.mesh import TetMesh, box_mesh
from physconvex.reduced import (
    BodySamples,
    ReducedBodies,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    eigenmode_weights,
    train_neural_weights,
)

RESULT = Path(__file__).parent / "results" / "reduced_scaling.json"
SIZE = (0.3, 0.2, 0.2)
TIMING = Timing(frames=24, steps_per_frame=8)


@dataclass(frozen=True)
class RollOutRow:
    """One roll-out; `bodies` > 1 stand for a stack of blocks that falls on the floor, with friction between them."""

    weights: int
    cubature_points: int
    bodies: int
    seconds: float
    newton_iterations: int
    factorisations: int


@dataclass(frozen=True)
class SetUpRow:
    """Weights of a body made before any roll-out."""

    what: str
    weights: int
    nodes: int
    seconds: float


def processor_seconds(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and how long it takes."""
    clock = time.process_time()
    result = call()
    return result, time.process_time() - clock


def one_body(cells: tuple[int, int, int], count: int) -> RollOutRow:
    """A dropped box."""
    mesh = box_mesh(SIZE, cells)
    body = ReducedBody(ReducedSpace(eigenmode_weights(ElasticBody(mesh), count), BodySamples.of_mesh(mesh)))
    scene = ReducedScene(body, obstacles=(Plane(point=(0, 0, -0.1)),))
    run, seconds = processor_seconds(lambda: simulate(scene, TIMING))
    cost = run.statistics
    return RollOutRow(count, len(body.mu), 1, seconds, cost.newton_iterations, cost.factorisations)


def several_bodies(number: int) -> RollOutRow:
    """A stack of blocks, a centimetre apart."""
    scenes = []
    for i in range(number):
        mesh = box_mesh((0.2, 0.2, 0.1), (3, 3, 2))
        mesh = TetMesh(mesh.vertices + np.array([0.0, 0.0, 0.11 * i]), mesh.tets)
        body = ReducedBody(ReducedSpace(eigenmode_weights(ElasticBody(mesh), 6), BodySamples.of_mesh(mesh)))
        scenes.append(ReducedScene(body, obstacles=(Plane(point=(0, 0, -0.01)),)))
    world = ReducedBodies(tuple(scenes), friction=0.4)
    run, seconds = processor_seconds(lambda: simulate(world, TIMING))
    cost = run.bodies[0].statistics
    return RollOutRow(6, len(scenes[0].body.mu), number, seconds, cost.newton_iterations, cost.factorisations)


def set_ups() -> Iterator[SetUpRow]:
    """Eigenmodes on 2,000 nodes, and the data-free neural field with its default options."""
    for mesh in (box_mesh(SIZE, (18, 9, 9), order=1), box_mesh(SIZE, (9, 5, 5))):
        _, seconds = processor_seconds(lambda mesh=mesh: eigenmode_weights(ElasticBody(mesh), 20))
        kind = "linear" if mesh.order == 1 else "quadratic"
        yield SetUpRow(f"eigenmodes, {kind} tetrahedra", 20, len(mesh.vertices), seconds)
    mesh = box_mesh(SIZE, (4, 3, 3))
    torch.set_num_threads(2)
    clock = time.perf_counter()
    train_neural_weights(BodySamples.of_mesh(mesh), 10, generator=torch.Generator().manual_seed(0))
    yield SetUpRow("neural field, on the clock", 10, len(mesh.vertices), time.perf_counter() - clock)
    torch.set_num_threads(1)


def roll_outs() -> Iterator[RollOutRow]:
    """By weights, by points, by bodies."""
    for count in (4, 10, 20, 40, 64):
        yield one_body((4, 3, 3), count)
    for cells in ((5, 4, 4), (6, 5, 5)):
        yield one_body(cells, 20)
    for number in (1, 2, 4):
        yield several_bodies(number)


def main() -> None:
    """Measure, print, store."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    torch.set_num_threads(1)
    content: dict[str, Any] = {"command": "python benchmarks/reduced_scaling.py", "set_up": [], "roll_outs": []}
    for name, rows in (("set_up", set_ups()), ("roll_outs", roll_outs())):
        for row in rows:
            print(row, flush=True)
            content[name].append(asdict(row))
    RESULT.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
