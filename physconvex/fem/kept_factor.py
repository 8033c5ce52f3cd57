"""An approximate inverse of a body's stiffness that lasts over many time steps.

Three things make one factor last: it turns with the body (a rotated body has the rotated stiffness); what the gradients
met since then tell of the stiffness is laid over it (L-BFGS in compact form: Byrd, Nocedal and Schnabel 1994, theorem
2.2, with the factor as the initial inverse); and contact is not in it.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix, identity

from physconvex.kabsch import best_rotation
from physconvex.linear_solvers import NotPositiveDefiniteError

if TYPE_CHECKING:
    from physconvex.fem.simulation import StepEquations

__all__ = ["KeptFactor"]

_SECANTS = 16  # pairs of changes kept
_CURVED = 1e-8  # cosine between change of place and of gradient below which a pair tells nothing
_ROUNDED = 1e-9  # share of the body's size below which a change of place is left out of them


class KeptFactor:
    """H ≈ (∂g/∂x)⁻¹, g the smooth gradient of the equations.

    Args:
        equations: of the time steps.
        matrix: takes the nodes to the points at which forces act, [S, V]; None: the nodes themselves.
    """

    def __init__(self, equations: StepEquations, matrix: csr_matrix | None) -> None:
        self.equations = equations
        count = len(equations.body.mesh.vertices)
        self._matrix = csr_matrix(identity(count)) if matrix is None else matrix
        self._on_free = csr_matrix(self._matrix[:, equations.assembler.free])
        self._masses = equations.body.node_masses
        self.turn = np.eye(3)  # R, of the body since the factorisation
        self.projected = False  # the factorised matrix was not positive definite as it was
        self.forget()

    def forget(self) -> None:
        """Give the factor up."""
        self._stamp, self._step = -1, np.nan
        self._place = self.equations.body.mesh.vertices
        self._secants = _Secants(_ROUNDED * self.equations.body.mesh.size)
        self._columns = np.zeros(len(self._matrix.indptr) - 1, dtype=np.int64) - 1  # of each point, if it has any
        self._points = np.zeros(0, dtype=np.int64)
        self._compliance = np.zeros((0, 0))

    def prepare(self, x: Float[np.ndarray, "V 3"], *, renew: bool) -> bool:
        """Make ready for a time step, or for the rest of one with a new factor; whether there is a new one."""
        equations = self.equations
        assert equations.coefficients is not None
        step = equations.coefficients.step
        self._secants.interrupt()
        if not renew and equations.factorisations == self._stamp and np.isclose(step, self._step):
            self.turn = best_rotation(self._place, x, self._masses)
            return False
        self.forget()
        self.projected, self.turn, self._place, self._step = False, np.eye(3), x, step
        try:
            equations.factorise_smooth(x, project=False)
        except NotPositiveDefiniteError:
            equations.factorise_smooth(x, project=True)
            self.projected = True
        self._stamp = equations.factorisations
        return True

    def apply(self, x: Float[np.ndarray, "V 3"], gradient: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """−H g [m]; learns from g."""
        turned = gradient @ self.turn  # Rᵀ g, node by node
        out = self.equations.solve(turned)
        self._secants.note(x @ self.turn, turned, out)
        return -(out + self._secants.correction(turned)) @ self.turn.T

    def compliance(self, points: Int[np.ndarray, " C"]) -> Float[np.ndarray, "N N"]:
        """B H Bᵀ [m/N] of some points, N = 3 C."""
        self._extend(points)
        at, size = self._columns[points], 3 * len(points)
        dofs = (3 * at[:, None] + np.arange(3)).ravel()
        out = self._compliance[np.ix_(dofs, dofs)]
        out += self._secants.correction_at(self._matrix[points])
        for _ in range(2):  # R S Rᵀ, block by block
            out = (self.turn @ out.reshape(len(points), 3, size)).reshape(size, size).T
        return np.ascontiguousarray(out)

    def pushed(self, points: Int[np.ndarray, " C"], forces: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "V 3"]:
        """H Bᵀ λ [m] of forces on some points [N]."""
        spread = self._matrix[points].T @ (forces @ self.turn)
        spread[self.equations.fixed] = 0.0
        return (self.equations.solve(spread) + self._secants.correction(spread)) @ self.turn.T

    def _extend(self, points: np.ndarray) -> None:
        """Solve for the columns of points that have none yet."""
        new = points[self._columns[points] < 0]
        if not len(new):
            return
        rows = self._on_free[new].tocoo()
        free, count = self._on_free.shape[1], len(new)
        columns = np.zeros((free, 3, count, 3))
        for axis in range(3):
            columns[rows.col, axis, rows.row, axis] = rows.data
        solved = self.equations.solver.solve(columns.reshape(3 * free, 3 * count)).reshape(free, 9 * count)
        known = len(self._points)
        self._points = np.concatenate([self._points, new])
        self._columns[new] = known + np.arange(count)
        at = (self._on_free[self._points] @ solved).reshape(3 * len(self._points), 3 * count)
        cross, own = at[: 3 * known], at[3 * known :]
        self._compliance = np.block([[self._compliance, cross], [cross.T, 0.5 * (own + own.T)]])


class _Secants:
    """H − K⁻¹ in compact form, Wᵀ M W, from pairs of changes s of place, y of gradient and K⁻¹ y.

    Args:
        smallest: component of a change of place below which its change of gradient is taken for rounding [m].
    """

    def __init__(self, smallest: float) -> None:
        self._smallest = smallest
        self._pairs: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=_SECANTS)
        self._last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._w, self._m = np.zeros((0, 0)), np.zeros((0, 0))

    def interrupt(self) -> None:
        """The function changes: the next gradient has nothing to do with the last one."""
        self._last = None

    def note(self, x: np.ndarray, gradient: np.ndarray, solved: np.ndarray) -> None:
        """Learn from a gradient and K⁻¹ times it."""
        now = x, gradient, solved
        if self._last is not None:
            s, y, z = (new - old for new, old in zip(now, self._last, strict=True))
            curved = float((s * y).sum()) > _CURVED * float(np.linalg.norm(s) * np.linalg.norm(y))
            if curved and np.abs(s).max() > self._smallest:
                self._pairs.append((s, y, z))
                self._compact()
        self._last = now

    def _compact(self) -> None:
        s, y, z = (np.stack([pair[k].ravel() for pair in self._pairs]) for k in range(3))
        products, curvature = s @ y.T, y @ z.T
        inverse = np.linalg.inv(np.triu(products))
        middle = np.diag(products.diagonal()) + 0.5 * (curvature + curvature.T)
        self._m = np.block([[inverse.T @ middle @ inverse, -inverse.T], [-inverse, np.zeros_like(inverse)]])
        self._w = np.concatenate([s, z])

    def correction(self, vector: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """(H − K⁻¹) times a vector."""
        if not self._pairs:
            return np.zeros_like(vector)
        return ((self._m @ (self._w @ vector.ravel())) @ self._w).reshape(vector.shape)

    def correction_at(self, matrix: csr_matrix) -> Float[np.ndarray, "N N"] | float:
        """B (H − K⁻¹) Bᵀ."""
        if not self._pairs:
            return 0.0
        by_node = self._w.reshape(len(self._w), -1, 3).transpose(1, 2, 0).reshape(matrix.shape[1], -1)
        at = (matrix @ by_node).reshape(3 * matrix.shape[0], -1)
        return at @ self._m @ at.T
