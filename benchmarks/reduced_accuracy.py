"""The reduced model against the full model: rms distance, and the bias of E and ν when it is fitted to the full motion.

python benchmarks/reduced_accuracy.py

One cube of 0.2 m, dropped on a tilted floor; both models on the same mesh, steps and contact, so that the table shows
the reduction alone. The full model is itself coarse (125 nodes): below its own discretisation error the sign of a bias
means nothing.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from physconvex.fem import ElasticBody, Scene, TetMesh, box_mesh
from physconvex.fem import simulate as simulate_full
from physconvex.reduced import (
    BodySamples,
    Plane,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    eigenmode_weights,
    parameter_values,
    simulate_with_sensitivities,
    with_parameters,
)

RESULT = Path(__file__).parent / "results" / "reduced_accuracy.json"
SIZE, FLOOR = 0.2, Plane(point=(0, 0, -0.05), normal=(0.15, 0.05, 1.0))
TIMING = {"frames": 10, "fps": 48.0, "steps_per_frame": 4}
NAMES = ("log10_youngs_modulus", "poisson_ratio")
ITERATIONS, LARGEST_STEP = 6, 0.15


@dataclass(frozen=True)
class Row:
    """One modulus [Pa] and number of weights: rms distance over nodes and frames [m], biases, cost of the fit [s]."""

    youngs_modulus: float
    poisson_ratio: float
    weights: int
    rms_at_truth: float
    bias_log10_youngs_modulus: float
    bias_poisson_ratio: float
    rms_fitted: float
    last_step: float
    seconds: float


def fit(mesh: TetMesh, observed: np.ndarray, youngs_modulus: float, poisson_ratio: float, count: int) -> Row:
    """Gauss–Newton from the truth."""
    clock = time.process_time()
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), count), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=youngs_modulus, poisson_ratio=poisson_ratio)
    scene = ReducedScene(body, obstacles=(FLOOR,), contact_stiffness=50 * youngs_modulus / SIZE)
    truth = parameter_values(scene, NAMES)
    values, distances, change = truth.copy(), [], np.zeros(2)
    for _ in range(ITERATIONS):
        run = simulate_with_sensitivities(with_parameters(scene, NAMES, values), NAMES, **TIMING)
        residual = (run.trajectory.positions(mesh.vertices) - observed).ravel()
        distances.append(float(np.sqrt((residual**2).mean())))
        jacobian = np.moveaxis(run.position_tangents(mesh.vertices), 1, -1).reshape(len(residual), -1)
        change = np.clip(-np.linalg.lstsq(jacobian, residual, rcond=None)[0], -LARGEST_STEP, LARGEST_STEP)
        moved = values + change
        moved[1] = np.clip(moved[1], 0.0, 0.49)
        change, values = moved - values, moved
    bias = values - truth
    return Row(
        youngs_modulus,
        poisson_ratio,
        count,
        rms_at_truth=distances[0],
        bias_log10_youngs_modulus=float(bias[0]),
        bias_poisson_ratio=float(bias[1]),
        rms_fitted=distances[-1],
        last_step=float(np.abs(change).max()),
        seconds=time.process_time() - clock,
    )


def main() -> None:
    """Run all settings and store the table."""
    torch.set_num_threads(1)
    mesh = box_mesh((SIZE,) * 3, (2, 2, 2))
    rows = []
    for modulus, ratio in ((3e4, 0.35), (3e5, 0.35)):
        body = ElasticBody(mesh, youngs_modulus=modulus, poisson_ratio=ratio)
        observed = simulate_full(Scene(body, obstacles=(FLOOR,)), **TIMING).positions
        for count in (4, 10, 20):
            rows.append(fit(mesh, observed, modulus, ratio, count))
            print(rows[-1], flush=True)
    RESULT.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
