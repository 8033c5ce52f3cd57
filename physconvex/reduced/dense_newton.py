"""Newton's linear algebra for the dense Hessians of reduced bodies: a kept Cholesky factor and secant corrections."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float
from scipy.linalg import lu_factor, lu_solve
from scipy.linalg.lapack import dpotrf, dpotrs

from physconvex.dynamics import StepCoefficients
from physconvex.numerics import NotPositiveDefiniteError
from physconvex.reduced.body import function_by_function
from physconvex.reduced.secant_corrections import Secants

_SECANTS = 8  # pairs of changes kept
_ROUNDED = 1e-9  # share of the body's size below which a change is ignored


class DenseNewton(ABC):
    """Linear algebra of a step of reduced coordinates y [R, 3].

    Args:
        size: of the bodies [m].
    """

    def __init__(self, size: float) -> None:
        self.factorised = False
        self.factorisations = 0
        self._factorised_step = np.nan
        self._factor: np.ndarray | None = None
        self.secants = Secants(_SECANTS, smallest=_ROUNDED * size)
        self.coefficients: StepCoefficients | None = None

    def first_guess(self, guess: Float[np.ndarray, "R 3"], time: float) -> Float[np.ndarray, "R 3"]:
        """Start of Newton's method: the extrapolation, since pins are springs."""
        return guess

    @abstractmethod
    def hessian_blocks(self, x: Float[np.ndarray, "R 3"], *, project: bool) -> Float[np.ndarray, "3 R 3 R"]:
        """Second derivative [N/m], components first; exact, or its positive definite approximation."""

    def hessian(self, x: Float[np.ndarray, "R 3"], *, project: bool = False) -> Float[np.ndarray, "N N"]:
        """The same, N = 3 R, ordered function by function."""
        return function_by_function(self.hessian_blocks(x, project=project))

    def factorise(self, x: Float[np.ndarray, "R 3"], *, project: bool) -> None:
        """Cholesky factor of the Hessian at x.

        Raises:
            NotPositiveDefiniteError: it is not positive definite.
        """
        self.factorised = False
        self._factor = None
        # symmetric, and its columns contiguous
        square = self.hessian_blocks(x, project=project).reshape(x.size, x.size).T
        if not np.isfinite(square[0, 0]) or not np.isfinite(square).all():
            raise NotPositiveDefiniteError("the reduced Hessian is not finite")
        factor, failed = dpotrf(square, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise NotPositiveDefiniteError(
                f"the reduced Hessian has no Cholesky factor: minor {failed} is not positive"
            )
        self._factor = factor
        self.secants.forget()
        self._factorised_step = np.nan if self.coefficients is None else self.coefficients.step
        self.factorisations += 1
        self.factorised = True

    def solve(self, rhs: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R 3"]:
        """Apply the inverse of the last factorised Hessian, corrected by the gradients evaluated since."""
        assert self._factor is not None
        return self.secants.solve(self._unfactor, rhs.reshape(-1)).reshape(rhs.shape)

    def _unfactor(self, rhs: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
        assert self._factor is not None
        by_component = rhs.reshape(-1, 3).T.reshape(-1)
        out, _ = dpotrs(self._factor, by_component, lower=1)
        return out.reshape(3, -1).T.reshape(-1)

    def exact_solve(self, x: Float[np.ndarray, "R 3"], rhs: Float[np.ndarray, "P R 3"]) -> Float[np.ndarray, "P R 3"]:
        """Apply the inverse of the exact Hessian at x to P vectors; it may be indefinite."""
        square = self.hessian_blocks(x, project=False).reshape(x.size, x.size).T
        columns = np.ascontiguousarray(rhs.transpose(2, 1, 0)).reshape(x.size, -1)
        factor, failed = dpotrf(square, lower=1, clean=0)
        if failed:
            solved = lu_solve(lu_factor(square, check_finite=False), columns, check_finite=False)
        else:
            solved, _ = dpotrs(factor, columns, lower=1)
        return solved.reshape(3, len(x), -1).transpose(2, 1, 0).copy()
