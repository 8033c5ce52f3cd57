"""An approximate inverse of a body's stiffness that lasts over many time steps.

Three things make one factor last: it turns with the body (a rotated body has the rotated stiffness); what the gradients
met since then tell of the stiffness is laid over it (L-BFGS in compact form: Byrd, Nocedal and Schnabel 1994, theorem
2.2, with the factor as the initial inverse); and contact is not in it.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float, Int

from physconvex.fem.step_equations import StepEquations
from physconvex.kabsch import best_rotation
from physconvex.linear_solvers import NotPositiveDefiniteError

__all__ = ["KeptFactor"]

_SECANTS = 16  # pairs of changes kept
_CURVED = 1e-8  # cosine between change of place and of gradient below which a pair tells nothing
_ROUNDED = 1e-9  # share of the body's size below which a change of place is left out of them


class KeptFactor:
    """H ≈ (∂g/∂x)⁻¹, g the smooth gradient of the equations.

    Args:
        equations: of the time steps.
    """

    def __init__(self, equations: StepEquations) -> None:
        self.equations = equations
        free = equations.assembler.free
        self._place_of = np.where(free, np.cumsum(free) - 1, -1)  # of each node among the free ones
        self._masses = equations.body.node_masses
        self.turn = np.eye(3)  # R, of the body since the factorisation
        self.projected = False  # the factorised matrix was not positive definite as it was
        self.forget()

    def forget(self) -> None:
        """Give the factor up."""
        self._stamp, self._step = -1, np.nan
        self._place = self.equations.body.mesh.vertices
        self._secants = _Secants(_ROUNDED * self.equations.body.mesh.size)
        self._columns = np.full(len(self._masses), -1)  # of each node, if it has any
        self._nodes = np.zeros(0, dtype=np.int64)
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

    def compliance(self, nodes: Int[np.ndarray, " M"]) -> Float[np.ndarray, "N N"]:
        """H [m/N] of some free nodes, N = 3 M."""
        self._extend(nodes)
        size = 3 * len(nodes)
        dofs = (3 * self._columns[nodes][:, None] + np.arange(3)).ravel()
        out = self._compliance[np.ix_(dofs, dofs)]
        out += self._secants.correction_at(nodes)
        for _ in range(2):  # R H Rᵀ, block by block
            out = (self.turn @ out.reshape(len(nodes), 3, size)).reshape(size, size).T
        return np.ascontiguousarray(out)

    def pushed(self, forces: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """H f [m] of forces [N] on the nodes."""
        turned = forces @ self.turn
        turned[self.equations.fixed] = 0.0
        return (self.equations.solve(turned) + self._secants.correction(turned)) @ self.turn.T

    def _extend(self, nodes: np.ndarray) -> None:
        """Solve for the columns of nodes that have none yet."""
        new = nodes[self._columns[nodes] < 0]
        if not len(new):
            return
        free, count, known = int((self._place_of >= 0).sum()), len(new), len(self._nodes)
        columns = np.zeros((free, 3, count, 3))
        for axis in range(3):
            columns[self._place_of[new], axis, np.arange(count), axis] = 1.0
        solved = self.equations.solver.solve(columns.reshape(3 * free, 3 * count)).reshape(free, -1)
        self._nodes = np.concatenate([self._nodes, new])
        self._columns[new] = known + np.arange(count)
        at = solved[self._place_of[self._nodes]].reshape(-1, 3 * count)
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

    def correction_at(self, nodes: np.ndarray) -> Float[np.ndarray, "N N"] | float:
        """H − K⁻¹ of some nodes."""
        if not self._pairs:
            return 0.0
        at = self._w.reshape(len(self._w), -1, 3)[:, nodes].reshape(len(self._w), -1)
        return at.T @ (self._m @ at)
