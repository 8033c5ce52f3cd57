"""Cost of the reduced model's parts on one core, in float64.

python benchmarks/reduced_speed.py
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from physconvex.fem import ElasticBody, box_mesh
from physconvex.integrators import State, implicit_euler
from physconvex.reduced import BodySamples, Plane, ReducedBody, ReducedScene, ReducedSpace, eigenmode_weights, simulate
from physconvex.reduced.equations import StepEquations

RESULT = Path(__file__).parent / "results" / "reduced_speed.json"


@dataclass(frozen=True)
class Row:
    """Processor times: set-up [s], one evaluation, one factorisation [ms], 24 frames of a drop, 16 steps each [s]."""

    weights: int
    functions: int
    cubature_points: int
    set_up: float
    energy_and_gradient: float
    elastic_hessian: float
    factorise: float
    evaluate: float
    frames_24: float
    newton_iterations: int
    factorisations: int


def milliseconds(call: Callable[[], object], repeats: int) -> float:
    """Processor time of one call."""
    call()
    clock = time.process_time()
    for _ in range(repeats):
        call()
    return 1e3 * (time.process_time() - clock) / repeats


def measure(full: ElasticBody, count: int) -> Row:
    """One number of weights."""
    clock = time.process_time()
    space = ReducedSpace(eigenmode_weights(full, count), BodySamples.of_mesh(full.mesh))
    set_up = time.process_time() - clock
    body = ReducedBody(space, youngs_modulus=1e5)
    scene = ReducedScene(body, obstacles=(Plane(point=(0, 0, -0.1)),))
    y = body.rest + 1e-4 * np.random.default_rng(0).normal(size=body.rest.shape)
    equations, still = StepEquations(scene), State(0.0, y, np.zeros_like(y))
    equations.set_step(implicit_euler(still, 0.003), 0.003, y, still)
    repeats = 20 if count < 40 else 4
    times = [
        milliseconds(call, repeats)
        for call in (
            lambda: body.energy_and_gradient(y),
            lambda: body.hessian(y),
            lambda: equations.factorise(y, project=False),
            lambda: equations.evaluate(y),
        )
    ]
    clock = time.process_time()
    cost = simulate(scene).statistics
    seconds = time.process_time() - clock
    return Row(
        count, space.dimension, len(body.mu), set_up, *times, seconds, cost.newton_iterations, cost.factorisations
    )


def main() -> None:
    """Run all settings and store the table."""
    torch.set_num_threads(1)
    full = ElasticBody(box_mesh((0.3, 0.2, 0.2), (4, 3, 3)))
    rows = []
    for count in (4, 10, 20):
        rows.append(measure(full, count))
        print(rows[-1], flush=True)
    RESULT.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
