"""Time steps that solve contact and friction together on the touching points; nothing is frozen.

A time step solves g(x) + Bᵀ c(B x) = 0. Here g is the gradient of the smooth terms (inertia, elasticity, viscosity) and
c the force of contact and Coulomb friction on points B x of the surface. Newton's method with an approximate inverse H
of ∂g/∂x, without contact, gives the change d = u − H Bᵀ λ with u = −H g and forces λ = c(B (x + d)). With the
compliance S = B H Bᵀ of the points this is an equation in λ alone (static condensation),

    λ = c(B (x + u) − S λ).

`physconvex.fem.dense_contact` solves it in a few steps for sticking, slipping and separating points. So nodes that
begin or cease to touch need no new factor, and normal force and friction agree at the end of the step without passes. H
is a factor kept over many steps (`physconvex.fem.kept_factor`).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from physconvex.dynamics import Minimum
from physconvex.errors import ConvergenceError
from physconvex.fem.carried_contact import CarriedContact
from physconvex.fem.compiled_contact import carry
from physconvex.fem.contact_problem import CarriedPoints
from physconvex.fem.dense_contact import DenseContact
from physconvex.fem.kept_factor import KeptFactor
from physconvex.fem.nodal_equations import NodalEquations

_MOST = 60  # Newton steps per time step
_TIRED = 14  # Newton steps after which the factor is renewed before the next time step
_PATIENCE = 6  # steps before a growing one counts against the factor
_WILD = 10.0  # growth that counts immediately
_EXACT, _SHARE, _FIRST = 1e-2, 2e-2, 1e-3  # error of the dense equation: of the tolerance, the last step, the first
_ENOUGH = 0.2  # of the tolerance: error of the dense equation at the end
_USUAL = 1.0 / 3.0  # remaining over last step of an error that shrinks fourfold


class CondensedContact:
    """Solves the time steps of the equations.

    Args:
        equations: of the steps.
        tolerance: Newton's last step [m].
    """

    def __init__(self, equations: NodalEquations, tolerance: float) -> None:
        self.equations, self.tolerance = equations, tolerance
        equations.freezes_friction = False
        contact = equations.contact
        self.matrix = contact.carried.matrix if isinstance(contact, CarriedContact) else None
        self.factor = KeptFactor(equations)
        self.dense = DenseContact(contact)
        self._free = equations.assembler.free
        self._known, self._carried = np.zeros(0, dtype=np.int64), self._carriers(np.zeros(0, dtype=np.int64))
        self._last = 0  # Newton steps of the last time step
        self._error = 0.0  # of the last dense equation [m]

    def solve(self, guess: np.ndarray) -> Minimum:
        """Positions [m] at the end of the step, from a first guess.

        Raises:
            ConvergenceError: Newton's method did not converge.
        """
        if not np.isfinite(guess).all():
            raise ConvergenceError("the first guess is not finite")
        x, size, since = guess, np.inf, 0
        fresh = self.factor.prepare(x, renew=self._last > _TIRED)
        projections = int(fresh and self.factor.projected)
        self._last = 0
        for number in range(1, _MOST + 1):
            gradient = self.equations.smooth_gradient(x)
            change, previous = self._change(x, gradient, size), size
            size = float(np.abs(change).max())
            if not fresh and self._is_lost(size, previous, since):
                fresh, since, previous = self.factor.prepare(x, renew=True), 0, np.inf
                projections += self.factor.projected
                change = self._change(x, gradient, previous)
                size = float(np.abs(change).max())
            if not size <= self.equations.body.mesh.size:
                break
            x, since, fresh = x + change, since + 1, False
            if self._is_enough(size, previous):
                self._last = number
                return Minimum(x, number, size, projections)
        self.factor.forget()
        raise ConvergenceError(f"Newton's method with condensed contact left a step of {size:.3e} m")

    def _is_lost(self, size: float, previous: float, since: int) -> bool:
        """Whether that many steps with one factor fail to converge, by the last two steps [m]."""
        grows = size >= previous and since >= _PATIENCE  # the first ones may grow if K is projected
        return grows or not size < _WILD * previous or since >= 2 * _TIRED

    def _is_enough(self, size: float, previous: float) -> bool:
        """Whether a step that long after the previous one [m] leaves as small an error as one at the tolerance."""
        share = min(1.0, _USUAL * (previous / max(size, np.finfo(float).tiny) - 1)) if np.isfinite(previous) else _USUAL
        return size <= share * self.tolerance and self._error <= _ENOUGH * self.tolerance

    def _change(self, x: np.ndarray, gradient: np.ndarray, last: float) -> np.ndarray:
        """d = u − H Bᵀ λ, after a step of the size `last` [m]."""
        free = self.factor.apply(x, gradient)
        time = self.equations.time
        before, after = (at if self.matrix is None else carry(self.matrix, at) for at in (x, x + free))
        self.dense.find(before, after, time)
        points = self.dense.points
        self._error = 0.0
        if not len(points):
            return free
        error = _SHARE * last if np.isfinite(last) else _FIRST * float(np.abs(free).max())
        c = self.equations.coefficients
        assert c is not None
        if not np.array_equal(points, self._known):
            self._known, self._carried = points, self._carriers(points)
        nodes, carried = self._carried
        base = (c.base if self.matrix is None else carry(self.matrix, c.base))[points]
        at = CarriedPoints(after[points], base, carried, self.factor.compliance(nodes), c.step, time)
        self._error = self.dense.solve(at, goal=max(error, _EXACT * self.tolerance))
        return free - self.factor.pushed(nodes, carried.T @ self.dense.total())

    def _carriers(self, points: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
        """The free nodes that carry some points, and the matrix from them to the points."""
        if self.matrix is None:
            rows = csr_matrix((np.ones(len(points)), (np.arange(len(points)), points)), (len(points), len(self._free)))
        else:
            rows = self.matrix[points]
        nodes = np.unique(rows.indices)
        nodes = nodes[self._free[nodes]]
        return nodes, csr_matrix(rows[:, nodes])
