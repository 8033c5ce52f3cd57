"""Newton's linear algebra for the dense Hessians of reduced bodies: a kept Cholesky factor and secant corrections."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.linalg import lu_factor, lu_solve
from scipy.linalg.blas import dtrsv
from scipy.linalg.lapack import dpotrf, dpotrs

from physconvex.dynamics import StepCoefficients
from physconvex.numerics import NotPositiveDefiniteError
from physconvex.reduced.body import function_by_function

_CURVED = 1e-8  # cosine between change of place and of gradient below which a pair is ignored
_SECANTS = 8  # pairs of changes kept
_ROUNDED = 1e-9  # share of the body's size below which a change is ignored


class Secants:
    """Pairs of changes of place and of gradient, which correct a factor kept over many steps; the oldest are dropped.

    The two-loop recursion of L-BFGS (Nocedal & Wright 2006, algorithm 7.4), with the factor K⁻¹ as the initial inverse.
    Each loop is a triangular system here, of the products of the changes of place S with those of gradient Y: with R
    the upper triangle of S Yᵀ and D its diagonal, R a = S r, q = r − Yᵀ a, Rᵀ b = D a − Y K⁻¹ q, and K⁻¹ q + Sᵀ b is
    the result.

    Args:
        memory: number of pairs kept.
        smallest: largest component of a change of place below which its change of gradient counts as rounding.
    """

    def __init__(self, memory: int, *, smallest: float) -> None:
        self._memory, self._smallest = memory, smallest
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self.forget()

    def forget(self) -> None:
        """Drop all pairs: there is a new factor."""
        self._places, self._gradients = np.zeros((0, 0)), np.zeros((0, 0))  # S and Y, the oldest first
        self._products = np.zeros((0, 0), order="F")  # S Yᵀ, its upper triangle

    def interrupt(self) -> None:
        """The function changes: the next gradient has nothing to do with the last one."""
        self._last = None

    def note(self, x: np.ndarray, gradient: np.ndarray) -> None:
        """Update with a gradient."""
        if self._last is not None:
            s, y = (x - self._last[0]).ravel(), (gradient - self._last[1]).ravel()
            product = float(s @ y)
            if np.abs(s).max() > self._smallest and product > _CURVED * np.sqrt(float(s @ s) * float(y @ y)):
                self._keep(s, y, product)
        self._last = (x, gradient)

    def _keep(self, s: np.ndarray, y: np.ndarray, product: float) -> None:
        first = max(len(self._places) + 1 - self._memory, 0)
        kept = self._places[first:].reshape(-1, len(s))
        count = len(kept)
        products = np.zeros((count + 1, count + 1), order="F")
        products[:count, :count] = self._products[first:, first:]
        products[:count, count], products[count, count] = kept @ y, product
        self._products = products
        self._places = np.concatenate([kept, s[None]])
        self._gradients = np.concatenate([self._gradients[first:].reshape(-1, len(s)), y[None]])

    def solve(self, inverse: Callable[[np.ndarray], np.ndarray], rhs: np.ndarray) -> np.ndarray:
        """Apply the corrected inverse to a vector."""
        if not len(self._places):
            return inverse(rhs)
        shares = dtrsv(self._products, self._places @ rhs)
        out = inverse(rhs - shares @ self._gradients)
        back = dtrsv(self._products, self._products.diagonal() * shares - self._gradients @ out, trans=1)
        return out + back @ self._places


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

    def begin(self, coefficients: StepCoefficients) -> None:
        """A new time step: a factor of another step size does not count."""
        self.coefficients = coefficients
        same = math.isclose(coefficients.step, self._factorised_step, rel_tol=1e-9)
        self.factorised = self.factorised and same

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
