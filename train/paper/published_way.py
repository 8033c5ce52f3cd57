"""The published method of fitting: ten neural skinning weights, implicit Euler with one step per frame, Adam.

Details that the paper does not state, or not in this project's documents, are chosen here: Adam's rates, and the
residuals of `physconvex refine` (followed points and outlines).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from inference import RefinementRun, RefineOptions, observe_capture
from physconvex import ConvergenceError
from physconvex.dynamics import IntegratorName, simulate
from physconvex.identify import (
    Observations,
    ReducedModel,
    Twin,
    TwinOptions,
    base_twin,
    default_parameter,
    lower_bounds,
    misfit_of,
    upper_bounds,
    with_weights,
)
from physconvex.io import Capture
from physconvex.reduced import train_neural_weights

NAMES = ("log10_youngs_modulus", "poisson_ratio")
_RATES = np.array([0.02, 0.005])  # Adam's, in decades and in ν
_BETAS, _TINY = (0.9, 0.999), 1e-12
_INTEGRATOR: IntegratorName = "implicit_euler"


@dataclass(frozen=True, eq=False)
class PublishedFit:
    """Result of Adam.

    Attributes:
        values: log10 E, ν.
        misfit: there.
        steps: number of steps; fewer than requested if the model fails.
        twin: the reduced body, with these values.
        nodes: its motion in all frames [m], shape [T, V, 3].
    """

    values: Float[np.ndarray, " 2"]
    misfit: float
    steps: int
    twin: Twin
    nodes: Float[np.ndarray, "T V 3"]


def fit_as_published(
    capture: Capture,
    start: Float[np.ndarray, " 2"],
    *,
    weights: int = 10,
    steps: int = 400,
    max_nodes: int = 500,
    seed: int = 0,
) -> PublishedFit:
    """Fit E and ν to a video by Adam.

    Args:
        capture: with a video and a rest geometry.
        start: log10 E, ν.
        weights: M.
        steps: of Adam.
        max_nodes: of the mesh that the body is integrated on.
        seed: of the weights' training.

    Raises:
        ConvergenceError: the model fails at the start.
    """
    twin = base_twin(capture, TwinOptions(weights, max_nodes, 1))
    generator = torch.Generator().manual_seed(seed)
    samples = twin.scene.body.space.samples
    twin = with_weights(twin, train_neural_weights(samples, weights, generator=generator))
    observed, twin = observe_capture(RefinementRun(capture, RefineOptions(observations="video")), twin)
    seen = observed.observations
    timing = replace(twin.timing(), integrator=_INTEGRATOR)
    model = ReducedModel(twin, NAMES, seen.points, int(seen.frames.max()) + 1, timing)
    values, made = _adam(model, seen, np.asarray(start, dtype=np.float64), steps)
    found = twin.with_values(NAMES, values)
    run = simulate(found.scene, timing)
    misfit = misfit_of(seen, model.positions(values))
    return PublishedFit(values, misfit, made, found, run.positions(twin.mesh.vertices))


def _adam(model: ReducedModel, seen: Observations, values: np.ndarray, steps: int) -> tuple[np.ndarray, int]:
    """Kingma & Ba 2015, within the bounds; the best values, and the steps made."""
    usual = [default_parameter(name) for name in NAMES]
    lower, upper = lower_bounds(usual), upper_bounds(usual)
    first, second = np.zeros(2), np.zeros(2)
    best, chosen = np.inf, values
    for step in range(1, steps + 1):
        try:
            residuals, jacobian = seen.linearise(*model.linearise(values))
        except ConvergenceError:
            if step == 1:
                raise
            return chosen, step - 1
        size, limit = np.abs(residuals), seen.robust_scales
        loss = float(np.where(size <= limit, 0.5 * size**2, limit * (size - 0.5 * limit)).sum())
        if loss < best:
            best, chosen = loss, values
        slope = jacobian.T @ (np.minimum(1.0, limit / np.maximum(size, 1e-300)) * residuals)
        first = _BETAS[0] * first + (1 - _BETAS[0]) * slope
        second = _BETAS[1] * second + (1 - _BETAS[1]) * slope**2
        way = (first / (1 - _BETAS[0] ** step)) / (np.sqrt(second / (1 - _BETAS[1] ** step)) + _TINY)
        values = np.clip(values - _RATES * way, lower, upper)
    return chosen, steps
