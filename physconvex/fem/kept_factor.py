"""An approximate inverse of a body's stiffness that lasts over many time steps.

Three things make one factor last. It rotates with the body (a rotated body has the rotated stiffness). Gradients
evaluated since the factorisation correct it (L-BFGS in compact form: Byrd, Nocedal and Schnabel 1994, theorem 2.2, with
the factor as the initial inverse). It excludes contact.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from physconvex.fem.compiled_contact import turned_blocks
from physconvex.fem.nodal_equations import NodalEquations
from physconvex.numerics import NotPositiveDefiniteError, best_rotation

_SECANTS = 16  # pairs of changes kept
_CURVED = 1e-8  # cosine between change of place and of gradient below which a pair is ignored
_MOST_ROWS = 3e5  # numbers: reading more takes longer than a solve
_ROUNDED = 1e-9  # share of the body's size below which a change of place is ignored


class KeptFactor:
    """H ≈ (∂g/∂x)⁻¹, g the smooth gradient of the equations.

    Args:
        equations: of the time steps.
    """

    def __init__(self, equations: NodalEquations) -> None:
        self.equations = equations
        free = equations.assembler.free
        self._place_of = np.where(free, np.cumsum(free) - 1, -1)  # of each node among the free ones
        self._masses = equations.body.node_masses
        self.turn = np.eye(3)  # R, of the body since the factorisation
        self.projected = False  # the factorised matrix is projected to a positive definite one
        self.forget()

    def forget(self) -> None:
        """Discard the factor."""
        self._stamp, self._step = -1, np.nan
        self._place = self.equations.body.mesh.vertices
        self._secants = _Secants(_ROUNDED * self.equations.body.mesh.size)
        self._columns = np.full(len(self._masses), -1)  # of each node, if it has any
        self._nodes = np.zeros(0, dtype=np.int64)
        self._compliance = np.zeros((0, 0))
        self._rows: np.ndarray | None = np.zeros((0, self.equations.assembler.size))  # K⁻¹ of their degrees of freedom

    def prepare(self, x: Float[np.ndarray, "V 3"], *, renew: bool) -> bool:
        """Prepare a time step, or the rest of one with a new factor; returns whether there is a new one."""
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
            equations.factorise(x, project=False, contact=False)
        except NotPositiveDefiniteError:
            equations.factorise(x, project=True, contact=False)
            self.projected = True
        self._stamp = equations.factorisations
        return True

    def apply(self, x: Float[np.ndarray, "V 3"], gradient: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """−H g [m]; updates the secants with g."""
        turned = gradient @ self.turn  # Rᵀ g, node by node
        out = self.equations.solve(turned)
        self._secants.note(x @ self.turn, turned, out)
        return -(out + self._secants.correction(turned)) @ self.turn.T

    def compliance(self, nodes: Int[np.ndarray, " M"]) -> Float[np.ndarray, "N N"]:
        """H [m/N] of some free nodes, N = 3 M."""
        self._extend(nodes)
        return turned_blocks(self._compliance, self._columns[nodes], self.turn, self._secants.correction_at(nodes))

    def pushed(self, nodes: Int[np.ndarray, " M"], forces: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "V 3"]:
        """H f [m] of forces [N] on some free nodes."""
        self._extend(nodes)
        turned = np.zeros(self._place.shape)
        turned[nodes] = forces @ self.turn
        if self._rows is None:
            out = self.equations.solve(turned)
        else:
            out = np.zeros_like(turned)
            out[self.equations.assembler.free] = (turned[self._nodes].ravel() @ self._rows).reshape(-1, 3)
        return (out + self._secants.correction(turned)) @ self.turn.T

    def _extend(self, nodes: np.ndarray) -> None:
        """Solve for the missing columns of nodes."""
        new = nodes[self._columns[nodes] < 0]
        if not len(new):
            return
        count, known = len(new), len(self._nodes)
        solved = self.equations.solver.inverse_rows(self._unknowns(new))
        if self._rows is not None:
            few = len(self._rows) + 3 * count <= _MOST_ROWS / solved.shape[1]
            self._rows = np.concatenate([self._rows, solved]) if few else None
        self._nodes = np.concatenate([self._nodes, new])
        self._columns[new] = known + np.arange(count)
        cross, own = np.split(np.take(solved, self._unknowns(self._nodes), axis=1), [3 * known], axis=1)
        grown = np.empty((3 * len(self._nodes), 3 * len(self._nodes)))
        grown[: 3 * known, : 3 * known], grown[: 3 * known, 3 * known :] = self._compliance, cross.T
        grown[3 * known :, : 3 * known], grown[3 * known :, 3 * known :] = cross, 0.5 * (own + own.T)
        self._compliance = grown

    def _unknowns(self, nodes: np.ndarray) -> Int[np.ndarray, " N"]:
        """Unknowns of the solver: three for each free node."""
        return (3 * self._place_of[nodes][:, None] + np.arange(3)).ravel()


class _Secants:
    """H − K⁻¹ in compact form, Wᵀ M W, from pairs of changes s of place, y of gradient and z = K⁻¹ y.

    Args:
        smallest: component of a change of place below which its change of gradient counts as rounding [m].
    """

    def __init__(self, smallest: float) -> None:
        self._smallest, self.count = smallest, 0
        self._last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._w = self._y = np.zeros((0, 0))  # s and z of the pairs [2 K, V·3], oldest first, and y [K, V·3]
        self._products, self._curvature = np.zeros((2, _SECANTS, _SECANTS))  # s yᵀ, of its upper triangle, and y zᵀ
        self._m = np.zeros((0, 0))

    def interrupt(self) -> None:
        """The function changes: the next gradient has nothing to do with the last one."""
        self._last = None

    def note(self, x: np.ndarray, gradient: np.ndarray, solved: np.ndarray) -> None:
        """Update with a gradient and K⁻¹ times it."""
        now = x, gradient, solved
        if self._last is not None:
            s, y, z = ((new - old).ravel() for new, old in zip(now, self._last, strict=True))
            curved = float(s @ y) > _CURVED * float(np.linalg.norm(s) * np.linalg.norm(y))
            if curved and np.abs(s).max() > self._smallest:
                self._add(s, y, z)
        self._last = now

    def _add(self, s: np.ndarray, y: np.ndarray, z: np.ndarray) -> None:
        if not self.count:
            self._w, self._y = np.zeros((2 * _SECANTS, len(s))), np.zeros((_SECANTS, len(s)))
        if self.count == _SECANTS:
            for rows in (self._w[:_SECANTS], self._w[_SECANTS:], self._y):
                rows[:-1] = rows[1:]
            for square in (self._products, self._curvature):
                square[:-1, :-1] = square[1:, 1:]
        else:
            self.count += 1
        last, count = self.count - 1, self.count
        self._w[last], self._w[_SECANTS + last], self._y[last] = s, z, y
        self._products[:count, last] = self._w[:count] @ y
        self._curvature[:count, last] = self._curvature[last, :count] = self._y[:count] @ z
        inverse = np.linalg.inv(np.triu(self._products[:count, :count]))
        middle = np.diag(self._products.diagonal()[:count]) + self._curvature[:count, :count]
        self._m = np.zeros((2 * _SECANTS, 2 * _SECANTS))
        self._m[:count, :count] = inverse.T @ middle @ inverse
        self._m[:count, _SECANTS : _SECANTS + count] = -inverse.T
        self._m[_SECANTS : _SECANTS + count, :count] = -inverse

    def correction(self, vector: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """(H − K⁻¹) times a vector."""
        if not self.count:
            return np.zeros_like(vector)
        return ((self._m @ (self._w @ vector.ravel())) @ self._w).reshape(vector.shape)

    def correction_at(self, nodes: np.ndarray) -> Float[np.ndarray, "N N"] | None:
        """H − K⁻¹ of some nodes; None without pairs."""
        if not self.count:
            return None
        at = self._w.reshape(len(self._w), -1, 3)[:, nodes].reshape(len(self._w), -1)
        return at.T @ (self._m @ at)
