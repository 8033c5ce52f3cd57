"""How well the data determine each parameter, in numbers and in plain words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from physconvex.identify.levenberg_marquardt import Fit
from physconvex.identify.parameters import lower_bounds, step_scales, upper_bounds

_LOOSE = 1.0  # a direction is undetermined when its deviation exceeds one typical step …
_CORRELATED = 0.95
_AT_BOUND = 1e-6


@dataclass(frozen=True)
class NullDirection:
    """A combination of parameters that the data do not determine: share by name (in typical steps), its deviation."""

    shares: tuple[tuple[str, float], ...]
    sigma: float


@dataclass(frozen=True, eq=False)
class Identifiability:
    """How well the data determine the parameters.

    Attributes:
        condition: largest over smallest singular value of the Jacobian, columns in typical steps.
        null_directions: undetermined combinations.
        at_bounds: names of the parameters at a bound.
        correlations: of the parameters, shape [K, K].
        sentences: the same in words.
    """

    condition: float
    null_directions: tuple[NullDirection, ...]
    at_bounds: tuple[str, ...]
    correlations: Float[np.ndarray, "K K"]
    sentences: tuple[str, ...]


def _information(found: Fit, variances: np.ndarray | float = 1.0, *, priors: bool = True) -> np.ndarray:
    """Jᵀ W V J in typical steps, with the priors."""
    scales = step_scales(found.parameters)
    rows = np.sqrt(found.weights * variances)[:, None] * found.jacobian * scales
    information = rows.T @ rows
    if priors:
        information += np.diag([(p.step / p.prior_sigma) ** 2 for p in found.parameters])
    return information


def _at_bounds(found: Fit) -> np.ndarray:
    near = _AT_BOUND * step_scales(found.parameters)
    above, below = found.values - lower_bounds(found.parameters), upper_bounds(found.parameters) - found.values
    return (above < near) | (below < near)


def noise_covariance(found: Fit) -> Float[np.ndarray, "K K"]:
    """Covariance from the stated noise and the priors, (Jᵀ W J + Σ₀⁻¹)⁻¹, in the parameters' units.

    Parameters at a bound are fixed there: their rows and columns are zero. Undetermined directions have a deviation of
    at most 10⁶ typical steps.
    """
    scales = step_scales(found.parameters)
    free = ~_at_bounds(found)
    out = np.zeros((len(scales), len(scales)))
    if free.any():
        values, vectors = np.linalg.eigh(_information(found)[np.ix_(free, free)])
        inner = (vectors / np.maximum(values, 1e-12)) @ vectors.T
        out[np.ix_(free, free)] = inner * np.outer(scales[free], scales[free])
    return out


def marginal_deviations(found: Fit, variances: Float[np.ndarray, " N"] | float = 1.0) -> Float[np.ndarray, " K"]:
    """Standard deviation of each parameter from noise and priors, also of those at a bound.

    Errors of the data or the model may push a parameter to its bound, which biases the others. Its true value may lie
    anywhere in its range: half the range is the deviation of a prior.

    Args:
        found: the fit.
        variances: of the residuals, if they differ from the stated ones. The fit is weighted by the stated ones, and
            its covariance is A⁻¹ (Jᵀ W V W J + Σ₀⁻¹) A⁻¹ with A = Jᵀ W J + Σ₀⁻¹ (White 1980).
    """
    scales = step_scales(found.parameters)
    half_ranges = np.array([(p.upper - p.lower) / (2 * p.step) for p in found.parameters])
    held = np.diag(np.where(_at_bounds(found), half_ranges**-2.0, 0.0))
    values, vectors = np.linalg.eigh(_information(found) + held)
    known = np.maximum(values, 1e-12)  # an undetermined value has a deviation of 10⁶ typical steps
    inverse = (vectors / known) @ vectors.T
    middle = _information(found, variances) + held + (vectors * (known - values)) @ vectors.T
    return np.asarray(scales * np.sqrt(np.diag(inverse @ middle @ inverse)))


def clustered_deviations(found: Fit, frames: Int[np.ndarray, " N"]) -> Float[np.ndarray, " K"]:
    """Standard deviations for residuals that are correlated within a frame, in the parameters' units.

    The sandwich H⁻¹ (Σ_t s_t s_tᵀ) H⁻¹ with s_t the gradient of frame t's share of the misfit (Liang & Zeger 1986),
    times T/(T − K). Points of one image share its errors and the model's, so that they determine less than as many
    independent points. Zero for parameters at a bound.

    Args:
        found: the fit.
        frames: frame of each residual.
    """
    rows = found.jacobian * (found.weights * found.residuals)[:, None]
    scores = np.stack([rows[frames == frame].sum(0) for frame in np.unique(frames)])
    shifts, count = scores @ noise_covariance(found), len(scores)
    factor = count / max(count - len(found.values), 1)
    return np.sqrt(factor * np.square(shifts).sum(0))


def identifiability(found: Fit) -> Identifiability:
    """How well the data of a fit determine the parameters (priors left out)."""
    names = np.array(found.names)
    information = _information(found, priors=False)
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 0.0)
    condition = float(np.sqrt(values[-1] / values[0])) if values[0] > 1e-12 * values[-1] else float("inf")
    spread = max(found.reduced_chi_square, 1.0)  # unexplained residuals count as noise here
    null = []
    for value, vector in zip(values, vectors.T, strict=True):
        sigma = float(np.sqrt(spread / max(value, 1e-24)))
        if sigma > _LOOSE:
            vector = vector * np.sign(vector[np.abs(vector).argmax()])
            shares = tuple((str(n), float(v)) for n, v in zip(names, vector, strict=True) if abs(v) > 0.2)
            null.append(NullDirection(shares, sigma))
    covariance = noise_covariance(found)
    deviations = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlations = covariance / np.outer(deviations, deviations)
    at_bounds = tuple(names[_at_bounds(found)])
    return Identifiability(
        condition, tuple(null), at_bounds, correlations, tuple(_sentences(found, null, at_bounds, correlations))
    )


def _sentences(
    found: Fit, null: list[NullDirection], at_bounds: tuple[str, ...], correlations: np.ndarray
) -> list[str]:
    out = []
    for direction in null:
        parts = " with ".join(f"{name} ({share:+.2f})" for name, share in direction.shares)
        out.append(f"The data do not determine {parts}: other values along this direction fit as well.")
    for name in at_bounds:
        value = found.value(name)
        out.append(f"{name} ended at its bound {value:g}: the data would have it beyond, or cannot tell; no interval.")
    names = found.names
    for i in range(len(names)):
        for j in range(i):
            if abs(correlations[i, j]) > _CORRELATED and not null:
                pair = f"{names[j]} and {names[i]}"
                out.append(f"{pair} can be traded against each other (correlation {correlations[i, j]:+.3f}).")
    if found.reduced_chi_square > 4:
        out.append(
            f"The residual is {np.sqrt(found.reduced_chi_square):.1f} times the stated noise: the model does not "
            "explain all that was seen, and intervals from noise alone are too small."
        )
    if not found.converged:
        out.append("The search did not converge within its iterations.")
    return out or ["All parameters are determined by the data."]
