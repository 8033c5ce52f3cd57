"""Cost of the reduced model's parts on one core, in float64.

python benchmarks/reduced_speed.py

Each setting is measured twice, with the arithmetic of plain numpy and with the compiled one.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import torch

from physconvex.dynamics import Plane, State, implicit_euler, simulate, simulate_with_sensitivities
from physconvex.fem import ElasticBody
from physconvex.kernels import Kernel
from physconvex.mesh import box_mesh
from physconvex.reduced import (
    BodySamples,
    NamedParameters,
    ReducedBody,
    ReducedEquations,
    ReducedScene,
    ReducedSpace,
    compiled_body as kernel,
    eigenmode_weights,
)

RESULT = Path(__file__).parent / "results" / "reduced_speed.json"


@dataclass(frozen=True)
class Row:
    """Processor times, medians.

    Attributes:
        weights: M.
        functions: R.
        cubature_points: Q.
        arithmetic: "plain" or "compiled".
        set_up: [s].
        energy_and_gradient, elastic_hessian: of the body [ms].
        factorise, evaluate: of the equations of a step: Hessian with its factor; value and gradient [ms].
        newton_iteration: one iteration with a fresh Hessian, its factor, the solve and the evaluation at its end [ms].
        frames_24: 24 frames of a drop on a smooth floor, 16 steps each [s]; median of three.
        newton_iterations, factorisations: of these.
        frames_24_rough: the same on a tilted floor of friction 0.3 [s].
        frames_24_damped: that with a damping time of 2 ms [s].
        sensitivities: rough floor with the derivatives by E, ν, friction [s].
    """

    weights: int
    functions: int
    cubature_points: int
    arithmetic: str
    set_up: float
    energy_and_gradient: float
    elastic_hessian: float
    factorise: float
    evaluate: float
    newton_iteration: float
    frames_24: float
    newton_iterations: int
    factorisations: int
    frames_24_rough: float
    frames_24_damped: float
    sensitivities: float


def milliseconds(call: Callable[[], object], repeats: int) -> float:
    """Processor time of one call, the median."""
    call()
    return 1e3 * float(np.median([seconds(call) for _ in range(repeats)]))


def seconds(call: Callable[[], object]) -> float:
    """Processor time of one call."""
    clock = time.process_time()
    call()
    return time.process_time() - clock


def newton_iteration(equations: ReducedEquations, y: np.ndarray, gradient: np.ndarray) -> None:
    """One iteration from y with a fresh Hessian: Hessian, factor, direction, value and gradient at its end."""
    equations.factorise(y, project=False)
    equations.evaluate(y - equations.solve(gradient))


def measure(full: ElasticBody, count: int, arithmetic: str) -> Row:
    """One number of weights."""
    clock = time.process_time()
    space = ReducedSpace(eigenmode_weights(full, count), BodySamples.of_mesh(full.mesh))
    set_up = time.process_time() - clock
    body = ReducedBody(space, youngs_modulus=1e5)
    scene = ReducedScene(body, obstacles=(Plane(point=(0, 0, -0.1)),))
    y = body.rest + 1e-4 * np.random.default_rng(0).normal(size=body.rest.shape)
    equations, still = ReducedEquations(scene), State(0.0, y, np.zeros_like(y))
    equations.set_step(implicit_euler(still, 0.003), 0.003, y, still)
    gradient = equations.evaluate(y)[1]
    repeats = 100 if count < 40 else 4
    part, hessian, factor, value, iteration = (
        milliseconds(call, repeats)
        for call in (
            lambda: body.energy_and_gradient(y),
            lambda: body.hessian(y),
            lambda: equations.factorise(y, project=False),
            lambda: equations.evaluate(y),
            lambda: newton_iteration(equations, y, gradient),
        )
    )
    smooth = float(np.median([seconds(lambda: simulate(scene)) for _ in range(3)]))
    cost = simulate(scene).statistics
    rough = replace(scene, obstacles=(Plane(point=(0, 0, -0.1), normal=(0.1, 0.05, 1.0), friction=0.3),))
    names = ["log10_youngs_modulus", "poisson_ratio", "friction"]
    return Row(
        count,
        space.dimension,
        len(body.mu),
        arithmetic,
        set_up,
        part,
        hessian,
        factor,
        value,
        iteration,
        smooth,
        cost.newton_iterations,
        cost.factorisations,
        seconds(lambda: simulate(rough)),
        seconds(lambda: simulate(replace(rough, damping_time=2e-3))),
        seconds(lambda: simulate_with_sensitivities(NamedParameters(rough, names))),
    )


def main() -> None:
    """Run all settings and store the table."""
    argparse.ArgumentParser(description=__doc__.split("\n")[0]).parse_args()
    torch.set_num_threads(1)
    rows = []
    for cells, count in (((4, 3, 3), 4), ((4, 3, 3), 10), ((7, 3, 2), 10), ((4, 3, 3), 20)):
        body = ElasticBody(box_mesh((0.3, 0.2, 0.2), cells))
        with patch.object(kernel, "REDUCED_KERNEL", Kernel(Path("not wanted"), {})):
            rows.append(measure(body, count, "plain"))
        rows.append(measure(body, count, "compiled"))
        print(*rows[-2:], sep="\n", flush=True)
    content = {"command": "python benchmarks/reduced_speed.py", "rows": [asdict(row) for row in rows]}
    RESULT.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
