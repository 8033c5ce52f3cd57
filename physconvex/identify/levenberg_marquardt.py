"""Levenberg–Marquardt on whitened residuals with bounds, Gaussian priors and Huber's loss.

Nocedal & Wright 2006, §10.3, with Marquardt's scaling. The damped step is a bounded linear least-squares problem, so
that a parameter at its bound leaves the others free. Steps are taken in `SearchCoordinates`. A step has at most half
the length of a failed one. If residuals stay large, the curvature that Gauss–Newton omits makes steps oscillate; the
last two steps estimate it and shorten the next one. Huber's loss enters by reweighting (weights min(1, k/|r|)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from physconvex.errors import ConvergenceError, InputError
from physconvex.identify.observations import Observations, model_misfit
from physconvex.identify.parameters import Parameter, SearchCoordinates, lower_bounds, starts, step_scales, upper_bounds
from physconvex.identify.point_models import PointModel, check_names
from physconvex.numerics import huber_loss, huber_weights

_ALONG = 0.7  # least cosine with the last step at which a step continues it or reverses it
_MOST_CURVATURE = 4.0  # times that of the linearisation
_LEAST = 1e-3  # least share of the predicted decrease at which a step is accepted
_ALONE = 0.5  # cost of a run without derivatives, in linearisations


@dataclass(frozen=True)
class FitOptions:
    """When to stop.

    Attributes:
        max_iterations: most linearisations. If derivatives need runs of their own (`FullModel.differenced`), a rejected
            trial has none and counts half.
        relative_tolerance: stop if the predicted decrease is below this share of the misfit …
        absolute_tolerance: … or below this value (half a squared standard deviation is 0.5). If the residuals exceed
            the stated noise, the standard deviation is that of the residuals.
        max_step: longest step of a parameter, in its typical steps.
        start_damping: Marquardt's λ at the start.
    """

    max_iterations: int = 15
    relative_tolerance: float = 1e-5
    absolute_tolerance: float = 1e-3
    max_step: float = 3.0
    start_damping: float = 1e-3


@dataclass(frozen=True, eq=False)
class Iteration:
    """One accepted state of the search: values [K], misfit (half the weighted squares, priors included), λ."""

    values: Float[np.ndarray, " K"]
    misfit: float
    damping: float


@dataclass(frozen=True, eq=False)
class Fit:
    """The result of a search.

    Attributes:
        parameters: the unknowns.
        values: their values, shape [K].
        positions: of the observed points at the solution [m], shape [T, P, 3].
        residuals: whitened, without those of the priors, shape [N].
        jacobian: their derivatives, shape [N, K].
        weights: of Huber's loss, shape [N].
        history: accepted states, the start first.
        converged: whether a tolerance was met.
        evaluations: states tried.
    """

    parameters: tuple[Parameter, ...]
    values: Float[np.ndarray, " K"]
    positions: Float[np.ndarray, "T P 3"]
    residuals: Float[np.ndarray, " N"]
    jacobian: Float[np.ndarray, "N K"]
    weights: Float[np.ndarray, " N"]
    history: tuple[Iteration, ...]
    converged: bool
    evaluations: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(p.name for p in self.parameters)

    @property
    def misfit(self) -> float:
        """Half the weighted squares, priors included."""
        return self.history[-1].misfit

    @property
    def reduced_chi_square(self) -> float:
        """Weighted squares over degrees of freedom: one if only the stated noise remains."""
        free = max(len(self.residuals) - len(self.values), 1)
        return float(self.weights @ self.residuals**2) / free

    def value(self, name: str) -> float:
        """Value of a parameter."""
        return float(self.values[self.names.index(name)])


@dataclass(frozen=True, eq=False)
class _Point:
    """A linearisation."""

    values: np.ndarray
    positions: np.ndarray
    residuals: np.ndarray
    jacobian: np.ndarray
    weights: np.ndarray
    misfit: float


def fit(
    model: PointModel, observations: Observations, parameters: Sequence[Parameter], *, options: FitOptions | None = None
) -> Fit:
    """Fit a model to observations, from the starts of the parameters.

    Raises:
        InputError: model and parameters do not fit together.
        ConvergenceError: the model cannot be evaluated at the start.
    """
    parameters = tuple(parameters)
    check_names(model.names, [p.name for p in parameters])
    options = options or FitOptions()
    search = _Search(model, observations, parameters, options)
    point = search.linearise(starts(parameters))
    damping, growth, longest, converged = options.start_damping, 2.0, options.max_step, False
    history, last = [Iteration(point.values, point.misfit, damping)], None
    while search.spent < options.max_iterations and not converged:
        wanted, promised = search.step(point, damping, options.max_step)
        curvature = _curvature(wanted, last)
        step = wanted / curvature
        if np.abs(step).max() > longest:
            step, promised = search.step(point, damping, longest)
            curvature = 1.0
        # ratio of the estimated to the stated noise
        excess = max(1.0, 2 * point.misfit / max(len(point.residuals) - len(parameters), 1))
        threshold = max(options.absolute_tolerance * excess, options.relative_tolerance * point.misfit)
        if promised < threshold:
            converged = True
            break
        promised, last = promised / curvature, (wanted, step)
        trial = search.tried(search.moved(point, step), point.misfit - _LEAST * promised)
        if trial is not None:
            gain = (point.misfit - trial.misfit) / promised
            converged = point.misfit - trial.misfit < threshold and promised < 10 * threshold
            point, growth = trial, 2.0
            if not 0.25 < gain < 0.75:
                longest = min(options.max_step, 2 * longest) if gain > 0.75 else 0.5 * float(np.abs(step).max())
            damping *= max(0.1, 1 - (2 * gain - 1) ** 3) if gain > 0.1 else 2.0
            history.append(Iteration(point.values, point.misfit, damping))
        else:
            # damping hardly changes a bounded step: a failed step is halved instead
            last = None
            damping, growth, longest = damping * growth, growth * 2.0, 0.5 * float(np.abs(step).max())
            converged = longest < 5e-6
    return Fit(
        parameters,
        point.values,
        point.positions,
        point.residuals,
        point.jacobian,
        point.weights,
        tuple(history),
        converged,
        search.evaluations,
    )


def _curvature(step: np.ndarray, last: tuple[np.ndarray, np.ndarray] | None) -> float:
    """Ratio of the true curvature along a step to the linearised one, estimated from the last step (Aitken).

    Args:
        step: step that the linearisation proposes.
        last: the last proposed step and the one taken.
    """
    if last is None:
        return 1.0
    wanted, taken = last
    if abs(step @ taken) < _ALONG * np.linalg.norm(step) * np.linalg.norm(taken):
        return 1.0
    return float(np.clip((wanted - step) @ taken / (taken @ taken), 1.0, _MOST_CURVATURE))


class _Search:
    def __init__(
        self, model: PointModel, observations: Observations, parameters: tuple[Parameter, ...], options: FitOptions
    ) -> None:
        self.model, self.observations, self.parameters = model, observations, parameters
        self.scales = step_scales(parameters)
        self.lower, self.upper = lower_bounds(parameters), upper_bounds(parameters)
        self.coordinates = SearchCoordinates([p.name for p in parameters])
        self.mean = np.array([p.prior_mean for p in parameters])
        self.precision = np.array([1 / p.prior_sigma for p in parameters])  # zero where there is no prior
        self.differenced = getattr(model, "differenced", False)
        self.evaluations, self.spent = 0, 0.0

    def linearise(self, values: np.ndarray) -> _Point:
        self._count(1.0)
        positions, tangents = self.model.linearise(values)
        residuals, jacobian = self.observations.linearise(positions, tangents)
        if len(residuals) == 0:
            raise InputError("observations: nothing was seen; expected at least one residual")
        limits = self.observations.robust_scales
        misfit = huber_loss(residuals, limits) + self._prior(values)
        return _Point(values, positions, residuals, jacobian, huber_weights(residuals, limits), misfit)

    def tried(self, values: np.ndarray, most: float) -> _Point | None:
        """The linearisation there; None if the misfit is not below `most`, or the model fails.

        In that case the step is shortened, which needs no derivatives if these cost runs of their own.
        """
        if self.differenced and not model_misfit(self.model, self.observations, values) + self._prior(values) < most:
            self._count(_ALONE)
            return None
        try:
            point = self.linearise(values)
        except ConvergenceError:
            return None
        return point if point.misfit < most else None

    def _prior(self, values: np.ndarray) -> float:
        return 0.5 * float(np.square((values - self.mean) * self.precision).sum())

    def _count(self, share: float) -> None:
        self.evaluations, self.spent = self.evaluations + 1, self.spent + share

    def step(self, point: _Point, damping: float, longest: float) -> tuple[np.ndarray, float]:
        """Damped step within the bounds and the given length, in typical steps, and the decrease of the misfit that the
        linearisation predicts."""
        scales, place = self.scales * self.coordinates.slopes(point.values), self.coordinates.of(point.values)
        root = np.sqrt(point.weights)
        rows = np.vstack([root[:, None] * point.jacobian, np.diag(self.precision)]) * scales
        target = -np.concatenate([root * point.residuals, (point.values - self.mean) * self.precision])
        q, triangle = np.linalg.qr(rows)
        right = q.T @ target
        norms = np.linalg.norm(triangle, axis=0)
        scaling = np.sqrt(damping) * np.maximum(norms, 1e-3 * norms.max(initial=1e-30))
        low = np.maximum((self.coordinates.of(self.lower) - place) / self.scales, -longest)
        high = np.minimum((self.coordinates.of(self.upper) - place) / self.scales, longest)
        high = np.maximum(high, low + 1e-12)
        matrix = np.vstack([triangle, np.diag(scaling)])
        found = lsq_linear(matrix, np.concatenate([right, np.zeros(len(scaling))]), bounds=(low, high))
        step = found.x
        promised = 0.5 * float(right @ right) - 0.5 * float(np.square(triangle @ step - right).sum())
        return step, promised

    def moved(self, point: _Point, step: np.ndarray) -> np.ndarray:
        """Values after a step."""
        values = self.coordinates.values(self.coordinates.of(point.values) + step * self.scales)
        near = 1e-9 * self.scales
        values = np.where(values < self.lower + near, self.lower, values)
        return np.asarray(np.where(values > self.upper - near, self.upper, values))
