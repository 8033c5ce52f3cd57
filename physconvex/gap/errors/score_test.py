"""Nuisance-projected score statistics: which effects the residual supports, without any fit.

With residual r = seen − model, X the motion by a unit dose, N the nuisances (tangents of the base parameters) and V the
covariance of noise and numerical errors,

    r = N δ + X a + ε,   ε ~ N(0, V):      a = (X̃ᵀ X̃)⁻¹ X̃ᵀ r̃,   T = |P_X̃ r̃|².

A tilde means whitened by V and projected off N (the effective score of Rao's test). V = diag(σ² + c κ² s²) + Σ_b d_b
d_bᵀ contains the noise; the size s of numerical differences at each frame, widened by c because residuals of a frame
share such errors (`physconvex.gap.errors.error_model`); and the differences d_b (effect-free runs on another mesh and
with other steps). A signature that looks like numerical error thus earns no score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.stats import chi2

from physconvex.errors import InputError


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Covariance V of residuals in units of the stated noise.

    Attributes:
        variance: diagonal part, shape [N].
        directions: d_b, shape [B, N].
        single: variance of one residual by itself, shape [N]; default `variance`, which is wider for shared errors.
    """

    variance: Float[np.ndarray, " N"]
    directions: Float[np.ndarray, "B N"]
    single: Float[np.ndarray, " N"] | None = None

    @classmethod
    def of_noise(cls, count: int) -> ErrorModel:
        """Covariance of residuals with the stated noise alone."""
        return cls(np.ones(count), np.zeros((0, count)))

    @property
    def expected(self) -> Float[np.ndarray, " N"]:
        """Expected square of each residual from noise and numerical error."""
        return self.variance if self.single is None else self.single

    def __post_init__(self) -> None:
        if not (self.variance > 0).all() or self.directions.shape[1:] != self.variance.shape:
            raise InputError(
                f"error model: got variance {self.variance.shape} and directions {self.directions.shape}; expected "
                "positive [N] and [B, N]"
            )

    @cached_property
    def _low_rank(self) -> tuple[np.ndarray, np.ndarray]:
        """U, g with V^(-1/2) = (I − U g Uᵀ) diag(variance)^(-1/2)."""
        scaled = (self.directions / np.sqrt(self.variance)).T
        if not scaled.shape[1]:
            return scaled, np.zeros(0)
        u, s, _ = np.linalg.svd(scaled, full_matrices=False)
        return u, 1 - 1 / np.sqrt(1 + s**2)

    def whiten(self, rows: Float[np.ndarray, "*B N"]) -> Float[np.ndarray, "*B N"]:
        """V^(-1/2) times vectors."""
        u, shrink = self._low_rank
        scaled = np.asarray(rows) / np.sqrt(self.variance)
        return scaled - ((scaled @ u) * shrink) @ u.T

    def restricted(self, rows: Float[np.ndarray, " n"]) -> ErrorModel:
        """Covariance of some of the residuals."""
        return ErrorModel(self.variance[rows], self.directions[:, rows], self.expected[rows])


@dataclass(frozen=True, eq=False)
class Projector:
    """Whitening by V, then projection off the nuisances."""

    errors: ErrorModel
    nuisances: Float[np.ndarray, "K N"]

    @cached_property
    def _basis(self) -> np.ndarray:
        whitened = self.errors.whiten(self.nuisances)
        u, s, _ = np.linalg.svd(whitened.T, full_matrices=False)
        return u[:, s > 1e-10 * s.max(initial=1e-300)]

    def apply(self, rows: Float[np.ndarray, "*B N"]) -> Float[np.ndarray, "*B N"]:
        """Whitened and projected vectors."""
        whitened = self.errors.whiten(rows)
        return whitened - (whitened @ self._basis) @ self._basis.T


@dataclass(frozen=True, eq=False)
class Score:
    """Score of one effect.

    Attributes:
        statistic: T, the part of the squared residual that the effect's directions explain.
        freedom: number of directions.
        p_value: probability of a larger T without the effect.
        amounts: multiples of the screened doses, shape [D]; zero if physics forbids the sign.
        errors: their standard errors, shape [D].
        visibility: share of the effect's signature that survives the projection, 0 to 1.
        explained: share of the projected residual's square that the effect explains, 0 to 1.
    """

    statistic: float
    freedom: int
    p_value: float
    amounts: Float[np.ndarray, " D"]
    errors: Float[np.ndarray, " D"]
    visibility: float
    explained: float


def score_effect(
    projector: Projector, residual: Float[np.ndarray, " N"], signature: Float[np.ndarray, "D N"], signs: Sequence[int]
) -> Score:
    """Compute the score of one effect.

    Args:
        projector: whitening and nuisances.
        residual: seen − model, in units of the noise.
        signature: change of the model by the screened doses, one row each.
        signs: +1 if only multiples ≥ 0 make sense, else 0.
    """
    left, x = projector.apply(residual), projector.apply(signature)
    x = np.atleast_2d(x)
    norms = np.linalg.norm(x, axis=1)
    raw = np.linalg.norm(projector.errors.whiten(signature), axis=-1)
    visibility = float(np.sqrt((norms**2).sum() / max((np.atleast_1d(raw) ** 2).sum(), 1e-300)))
    gram = x @ x.T
    ridge = 1e-10 * max(np.trace(gram), 1e-300)
    amounts = least_squares(x, left, signs)
    gain = float(left @ left - np.square(left - amounts @ x).sum())
    covariance = np.linalg.inv(gram + ridge * np.eye(len(gram)))
    freedom = len(x)
    p_value = float(chi2.sf(max(gain, 0.0), freedom))
    if all(signs) and freedom == 1:  # one-sided: half of the weight lies at zero
        p_value = 0.5 * p_value if amounts[0] > 0 else 1.0
    return Score(
        statistic=max(gain, 0.0),
        freedom=freedom,
        p_value=p_value,
        amounts=amounts,
        errors=np.sqrt(np.diag(covariance)),
        visibility=visibility,
        explained=max(gain, 0.0) / max(float(left @ left), 1e-300),
    )


def least_squares(x: np.ndarray, target: np.ndarray, signs: Sequence[int]) -> np.ndarray:
    """Least-squares multiples of the rows x for a target, with signs kept: free ones enter the problem twice."""
    free = [i for i, sign in enumerate(signs) if not sign]
    rows = np.vstack([x, -x[free]])
    solution, _ = nnls(rows.T, target)
    amounts = solution[: len(x)].copy()
    amounts[free] -= solution[len(x) :]
    return amounts
