"""Cost of the reduced model's parts on one core, in float64.

python benchmarks/reduced_speed.py
python benchmarks/reduced_speed.py --candidates 1 16 64 256      (only these rows; --device cuda)

Each setting is measured twice, with the arithmetic of plain numpy and with the compiled one. The rows that an earlier
state of the code gave (`before` in the stored file) are kept beside the new ones.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

from physconvex.dynamics import Plane, State, implicit_euler
from physconvex.fem import ElasticBody
from physconvex.kernels import KernelUnavailable
from physconvex.mesh import box_mesh
from physconvex.reduced import (
    BodySamples,
    Candidates,
    CandidateTrajectories,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    StepEquations,
    compiled_body as kernel,
    eigenmode_weights,
    optimised_cubature,
    simulate,
    simulate_candidates,
    simulate_with_sensitivities,
)

RESULT = Path(__file__).parent / "results" / "reduced_speed.json"


@dataclass(frozen=True)
class Row:
    """Processor times, medians.

    Attributes:
        weights: M.
        functions: R.
        cubature_points: Q.
        cubature: "all" points of the tetrahedra, or "optimised".
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
    cubature: str
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


def newton_iteration(equations: StepEquations, y: np.ndarray, gradient: np.ndarray) -> None:
    """One iteration from y with a fresh Hessian: Hessian, factor, direction, value and gradient at its end."""
    equations.factorise(y, project=False)
    equations.evaluate(y - equations.solve(gradient))


def measure(full: ElasticBody, count: int, points: int | None, arithmetic: str) -> Row:
    """One number of weights, with all cubature points or so many optimised ones."""
    clock = time.process_time()
    samples = BodySamples.of_mesh(full.mesh)
    space = ReducedSpace(eigenmode_weights(full, count), samples)
    if points is not None:
        chosen = optimised_cubature(ReducedBody(space), points, generator=np.random.default_rng(0))
        space = ReducedSpace(space.field, replace(samples, interior=chosen))
    set_up = time.process_time() - clock
    body = ReducedBody(space, youngs_modulus=1e5)
    scene = ReducedScene(body, obstacles=(Plane(point=(0, 0, -0.1)),))
    y = body.rest + 1e-4 * np.random.default_rng(0).normal(size=body.rest.shape)
    equations, still = StepEquations(scene), State(0.0, y, np.zeros_like(y))
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
        "all" if points is None else "optimised",
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
        seconds(lambda: simulate_with_sensitivities(rough, names)),
    )


@dataclass(frozen=True)
class CandidateRow:
    """So many candidates at once: 24 frames of 8 steps, M = 10, all 864 points, smooth floor.

    Attributes:
        device: "cpu" (one thread) or the name of the GPU.
        candidates: B.
        seconds: of the roll-out, processor time on the CPU, wall time on a GPU.
        per_candidate: seconds over B.
        alone: the same by `simulate`, one after the other, per candidate [s]; processor time.
        newton_iterations, factorisations: mean over the candidates.
        largest_difference: of the coordinates from those by `simulate` [m], over the first four candidates.
    """

    device: str
    candidates: int
    seconds: float
    per_candidate: float
    alone: float
    newton_iterations: float
    factorisations: float
    largest_difference: float


def measure_candidates(count: int, device: str) -> CandidateRow:
    """One number of candidates: E from 10 kPa to 1 MPa, ν from .2 to .45."""
    full = ElasticBody(box_mesh((0.3, 0.2, 0.2), (4, 3, 3)))
    body = ReducedBody(ReducedSpace(eigenmode_weights(full, 10), BodySamples.of_mesh(full.mesh)))
    scene = ReducedScene(body, obstacles=(Plane(point=(0, 0, -0.1)),))
    rng = np.random.default_rng(0)
    moduli, ratios = 10 ** rng.uniform(4, 6, count), rng.uniform(0.2, 0.45, count)
    timing: dict[str, Any] = {"frames": 24, "steps_per_frame": 8}

    def run() -> CandidateTrajectories:
        found = simulate_candidates(scene, Candidates(moduli, ratios), device=device, **timing)
        if device != "cpu":
            torch.cuda.synchronize()
        return found

    if device != "cpu":
        run()
    clock, wall = time.process_time(), time.perf_counter()
    found = run()
    spent = time.process_time() - clock if device == "cpu" else time.perf_counter() - wall
    some = list(zip(moduli[:4], ratios[:4], strict=True))
    clock = time.process_time()
    singles = [
        simulate(replace(scene, body=body.with_material(youngs_modulus=e, poisson_ratio=nu)), **timing).coordinates
        for e, nu in some
    ]
    alone = (time.process_time() - clock) / len(some)
    difference = np.abs(found.coordinates[: len(some)].cpu().numpy() - np.stack(singles)).max()
    return CandidateRow(
        device if device == "cpu" else torch.cuda.get_device_name(),
        count,
        spent,
        spent / count,
        alone,
        float(found.iterations.mean()),
        float(found.factorisations.mean()),
        float(difference),
    )


def store_candidates(counts: list[int], device: str) -> None:
    """Measure and keep beside the other rows."""
    for count in counts:
        row = measure_candidates(count, device)
        print(row, flush=True)
        stored = json.loads(RESULT.read_text())
        others = [r for r in stored.get("candidates", []) if (r["device"], r["candidates"]) != (row.device, count)]
        stored["candidates"] = sorted([*others, asdict(row)], key=lambda r: (r["device"], r["candidates"]))
        RESULT.write_text(json.dumps(stored, indent=1) + "\n")


def main() -> None:
    """Run all settings and store the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--candidates", type=int, nargs="+", help="measure so many candidates at once, nothing else")
    parser.add_argument("--device", default="cpu", help="of the candidates")
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.candidates:
        store_candidates(options.candidates, options.device)
        return
    stored = json.loads(RESULT.read_text())
    before = stored if isinstance(stored, list) else stored["before"]
    rows = []
    for cells, count, points in (
        ((4, 3, 3), 4, None),
        ((4, 3, 3), 10, None),
        ((4, 3, 3), 10, 300),
        ((7, 3, 2), 10, None),
        ((4, 3, 3), 20, None),
        ((4, 3, 3), 20, 500),
    ):
        body = ElasticBody(box_mesh((0.3, 0.2, 0.2), cells))
        with patch.object(kernel, "load_library", side_effect=KernelUnavailable("not wanted")):
            rows.append(measure(body, count, points, "plain"))
        rows.append(measure(body, count, points, "compiled"))
        print(*rows[-2:], sep="\n", flush=True)
    content = {
        "command": "python benchmarks/reduced_speed.py",
        "before": before,
        "rows": [asdict(row) for row in rows],
        "candidates": stored.get("candidates", []) if isinstance(stored, dict) else [],
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
