"""Adds the differences to a finer mesh and a shorter time step, and estimates the error that remains.

    x(p) ≈ x_coarse(p) + (1 + a) [x_fine(p₀) − x_coarse(p₀)] + 4/3 [x_half(p₀) − x_coarse(p₀)],

The sum is fitted from p₀, and again from the result, with the derivatives at p₀. The time step is extrapolated (BDF2 is
of second order). The mesh is extrapolated with a = 0.42 (order 1.75) if all edges are halved and there is no impact:
corners of a clamp reduce the order below the third of smooth displacements.

The remaining error is a third of the step's difference and half of the mesh's difference. If a is added, it is 0.3 of
the mesh's difference, since the difference does not shrink uniformly. For log10 E it is 0.12: coarse elements are too
stiff everywhere, which one number describes well. For a fit on the finer mesh, a quarter of the same differences
remains. The step's difference is that of the fitted mesh, because after an impact it differs from mesh to mesh.

The effect on a parameter is Σ_t g_t, where g_t is the first-order shift by frame t. After an impact the errors of
successive frames are nearly independent, so that √Σ g_t² is taken if it is larger.

e_t is the rms, over the residuals of frame t, of the whitened difference between two discretisations. In further fits
each residual of that frame is divided by √(1 + e_t²): noise and model error count as independent variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from physconvex.identify.correction import FULL_OPTIONS, parameter_shifts
from physconvex.identify.levenberg_marquardt import Fit, fit
from physconvex.identify.model import FullModel, roll_out_together
from physconvex.identify.observations import Jacobian, Observations, Residuals, WrappedObservations
from physconvex.identify.parameters import Parameter, step_scales
from physconvex.identify.point_models import LinearModel, PointModel, Positions, Tangents
from physconvex.identify.uncertainty import noise_covariance
from physconvex.mesh import Embedding, TetMesh

_EXTRAPOLATED = 4.0 / 3.0
_STEP_LEFT = 1.0 / 3.0
_TURNS = 3  # at most
_SETTLED = 0.3  # of a standard deviation
_FAR = 0.2  # typical steps
_BELIEVED = 1.0  # typical steps
_RUNS_AWAY = 0.5  # typical steps, in the last turn
_LINEAR_OPTIONS = replace(FULL_OPTIONS, max_iterations=30)  # a straight line costs nothing


@dataclass(frozen=True)
class _Share:
    """Shares of the mesh's difference: added beyond the finer mesh, remaining, and remaining for log10 E."""

    added: float
    left: float
    left_of_modulus: float

    def left_of(self, parameters: Sequence[Parameter]) -> np.ndarray:
        """The remaining share of the effect on each parameter, shape [K]."""
        return np.array([self.left_of_modulus if p.name == "log10_youngs_modulus" else self.left for p in parameters])


# a halving at the order 1.75 leaves 0.42 of its difference. The remaining share is calibrated on the sixty bars of
# docs/results/refinement.md; four bars that are halved twice leave 0.58 to 0.73 (benchmarks/mesh_order.py)
_HALVED, _OTHERWISE = _Share(0.42, 0.3, 0.12), _Share(0.0, 0.5, 0.5)
# of meshes with two to three times the nodes, and the best of several meshers
LEFT_BY_FITTED = 0.25
_FITTED = _Share(0.0, LEFT_BY_FITTED, LEFT_BY_FITTED)


@dataclass(frozen=True, eq=False)
class FinerFit:
    """A fit with the differences added.

    Attributes:
        fit: of the cheap model, shifted.
        left: standard deviation of each value by the remaining error, shape [K].
        frame_errors: e_t, the remaining error by frame, in standard deviations of the noise, shape [T].
        runs_away: whether the last turn moves a value by more than half a typical step. The meshes then diverge (a body
            that lands on thin legs) and do not determine the values.
    """

    fit: Fit
    left: Float[np.ndarray, " K"]
    frame_errors: Float[np.ndarray, " T"]
    runs_away: bool = False


def fit_finer(
    cheap: PointModel, coarse: FullModel, mesh: TetMesh | None, observations: Observations, found: Fit
) -> FinerFit:
    """Fit again with the differences to a finer mesh and to half the time step.

    Every turn runs the finest model at the result of the preceding turn. The derivatives, the step's difference and the
    errors are kept until the values move far from where they are computed.

    Args:
        cheap: gives the derivatives: the full model or the reduced one; it is on the finer mesh if `found` is.
        coarse: the full model.
        mesh: the finer mesh; None: the time step alone.
        observations: the observations.
        found: the fit of the full model, on either mesh.

    Raises:
        ConvergenceError: a finer model fails.
    """
    finest = replace(coarse, mesh=coarse.mesh if mesh is None else mesh)
    scales = step_scales(found.parameters)
    values, last, there, runs_away = found.values, found, None, False
    for _ in range(_TURNS):
        if there is None or (np.abs(values - there.anchor) > _FAR * scales).any():
            there = _differences(cheap, coarse, finest, observations, values)
            best = there.finest
        else:
            best = finest.positions(values)
        start = tuple(p.at(float(v)) for p, v in zip(found.parameters, values, strict=True))
        model = LinearModel(cheap.names, values, best + there.beyond, there.tangents)
        last = fit(model, there.weighted, [_near(p) for p in start], options=_LINEAR_OPTIONS)
        last = replace(last, parameters=start)
        moved, values = np.abs(last.values - values), last.values
        settled = bool((moved <= _SETTLED * np.sqrt(np.diag(noise_covariance(last)))).all())
        runs_away = not settled and bool((moved > _RUNS_AWAY * scales).any())
        if settled:
            break
    assert there is not None
    left = np.hypot(
        there.share.left_of(last.parameters) * there.effect(last, there.by_mesh),
        _STEP_LEFT * there.effect(last, there.by_step),
    )
    return FinerFit(last, left, there.errors, runs_away)


@dataclass(frozen=True, eq=False)
class _Differences:
    """At `anchor` [K]: coarse positions [T, P, 3] m, the additions of mesh and step, tangents, errors by frame."""

    anchor: np.ndarray
    coarse: np.ndarray
    by_mesh: np.ndarray
    by_step: np.ndarray
    share: _Share
    tangents: np.ndarray
    errors: np.ndarray
    weighted: WeightedObservations

    @property
    def finest(self) -> np.ndarray:
        return np.asarray(self.coarse + self.by_mesh)

    @property
    def beyond(self) -> np.ndarray:
        """The correction of the finer mesh's positions [m]."""
        return np.asarray(self.share.added * self.by_mesh + _EXTRAPOLATED * self.by_step)

    def effect(self, found: Fit, difference: np.ndarray) -> np.ndarray:
        """How far a difference of the positions [m] moves each value: |Σ_t g_t|, or √Σ g_t² if that is more."""
        change = self.weighted.residuals(self.coarse + difference) - self.weighted.residuals(self.coarse)
        by_frame = parameter_shifts(found, change, np.asarray(self.weighted.frames))
        return np.maximum(np.abs(by_frame.sum(0)), np.sqrt(np.square(by_frame).sum(0)))


def _near(parameter: Parameter) -> Parameter:
    """The same parameters, with bounds within which the linearisation holds."""
    lower, upper = parameter.start - _BELIEVED * parameter.step, parameter.start + _BELIEVED * parameter.step
    return replace(parameter, lower=max(parameter.lower, lower), upper=min(parameter.upper, upper))


def _differences(
    cheap: PointModel, coarse: FullModel, finest: FullModel, observations: Observations, values: np.ndarray
) -> _Differences:
    fitted = isinstance(cheap, FullModel) and cheap.rolled_mesh is not coarse.rolled_mesh
    stepped = finest if fitted else coarse  # after an impact the differences of two meshes are different
    half = replace(stepped, refinement=2 * stepped.refinement)
    roll_out_together(
        [(half, values), (finest, values), (coarse, values)],
        beside=[(cheap, values)] if isinstance(cheap, FullModel) else [],
    )
    tangents = cheap.linearise(values)[1]
    x, fine, long, short = (model.positions(values) for model in (coarse, finest, stepped, half))
    share = _FITTED if fitted else _share(coarse, finest)
    errors = np.hypot(
        share.left * frame_errors(observations, fine, x), _STEP_LEFT * frame_errors(observations, short, long)
    )
    weighted = WeightedObservations.by_errors(observations, errors)
    return _Differences(values, x, fine - x, short - long, share, tangents, errors, weighted)


def _share(coarse: FullModel, finest: FullModel) -> _Share:
    halved = len(finest.rolled_mesh.tets) == 8 * len(coarse.rolled_mesh.tets)
    return _HALVED if halved and not coarse.twin.may_strike else _OTHERWISE


def extrapolated_nodes(
    coarse: FullModel, finest: FullModel, values: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "T V 3"]:
    """Positions [m] of the finest mesh's nodes at the frames, with the fit's share of the meshes' difference."""
    nodes, share = finest.node_positions(values), _share(coarse, finest)
    if not share.added:
        return nodes
    carried = Embedding.of_points(coarse.rolled_mesh, finest.rolled_mesh.vertices).apply(coarse.node_positions(values))
    return np.asarray(nodes + share.added * (nodes - carried))


def frame_errors(
    seen: Observations, fine: Float[np.ndarray, "T P 3"], coarse: Float[np.ndarray, "T P 3"]
) -> Float[np.ndarray, " T"]:
    """e_t: rms of the whitened difference of two models' positions [m] in each frame, in standard deviations."""
    change = seen.residuals(fine) - seen.residuals(coarse)
    counts = np.bincount(seen.frames, minlength=len(fine))
    return np.sqrt(np.bincount(seen.frames, change**2, minlength=len(fine)) / np.maximum(counts, 1))


@dataclass(frozen=True, eq=False)
class WeightedObservations(WrappedObservations):
    """Observations with a factor on the residuals of each frame.

    Attributes:
        seen: the observations.
        factors: by frame, shape [T].
    """

    factors: Float[np.ndarray, " T"]

    @classmethod
    def by_errors(cls, seen: Observations, errors: Float[np.ndarray, " T"]) -> WeightedObservations:
        """Factors 1/√(1 + e_t²)."""
        return cls(seen, 1.0 / np.sqrt(1.0 + np.square(errors)))

    def in_frames(self, count: int) -> WeightedObservations:
        """The first `count` frames alone; the points stay."""
        return WeightedObservations(self.seen.in_frames(count), self.factors[:count])

    def residuals(self, positions: Positions) -> Residuals:
        """(model − seen)/σ times the factors."""
        return self.factors[self.frames] * self.seen.residuals(positions)

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """The residuals and their derivatives."""
        residuals, jacobian = self.seen.linearise(positions, tangents)
        factors = self.factors[self.frames]
        return factors * residuals, factors[:, None] * jacobian
