"""Contact forces on the touching points, from their positions without forces and their compliance.

The equation λ = c(y − S λ) is solved by a semi-smooth Newton method on its form with a resolvent
(`physconvex.fem.contact_problem`).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Contact
from physconvex.errors import ConvergenceError
from physconvex.fem.compiled_contact import add_near, contact_kind
from physconvex.fem.contact_problem import CarriedPoints, ContactProblem

_MOST = 60  # Newton steps
_HALVINGS = 6


class DenseContact:
    """Forces of every obstacle on every point, kept from solve to solve as the first guess.

    Args:
        law: of contact.
    """

    def __init__(self, law: Contact) -> None:
        self.law = law
        self._forces = np.zeros((len(law.obstacles), len(law.areas), 3))
        self._pressed = np.zeros(self._forces.shape[:2], dtype=bool)  # where they are not zero
        self.points = np.zeros(0, dtype=np.int64)  # that touch, or would without the forces
        self._of_pair = self._obstacle = self.points  # a pair is one of them and an obstacle

    def find(self, x: Float[np.ndarray, "S 3"], moved: Float[np.ndarray, "S 3"], time: float) -> None:
        """Find the points that touch at x or at `moved` [m], or at the last solve."""
        touching = self._pressed.copy()
        add_near(self.law, x, moved, time, touching)
        self._obstacle, pairs = np.nonzero(touching)
        self.points = np.flatnonzero(touching.any(axis=0))
        self._of_pair = np.searchsorted(self.points, pairs)

    def total(self) -> Float[np.ndarray, "C 3"]:
        """Force on each of `points`, as a gradient [N]."""
        return self._forces[:, self.points].sum(axis=0)

    def solve(self, at: CarriedPoints, *, goal: float) -> float:
        """Find the forces; returns the remaining error [m].

        Args:
            at: positions and compliance of `points`.
            goal: largest accepted error [m].

        Raises:
            ConvergenceError: no solution found.
        """
        points = self.points[self._of_pair]
        problem = contact_kind()(self.law, points, self._obstacle, at.select(self._of_pair))
        forces = self._forces[self._obstacle, points]
        left, slope = problem.residual(forces)
        for _ in range(_MOST):
            if (error := problem.size(left)) <= goal:
                self._forces[:] = 0.0
                self._forces[self._obstacle, points] = forces
                self._pressed[:] = False
                self._pressed[self._obstacle, points] = forces.any(axis=1)
                return error
            forces, left, slope = _searched(problem, forces, left, problem.newton_step(left, slope))
        raise ConvergenceError(f"the forces of contact are left off by {error:.3e} m")


def _searched(
    problem: ContactProblem, forces: np.ndarray, left: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best of a few step lengths: forces, remaining error, and the slope there."""
    start, length, least = problem.norm(left), 1.0, np.inf
    best = forces, left, np.zeros((len(forces), 3, 3))
    for _ in range(_HALVINGS):
        at = forces + length * step
        tried, slope = problem.residual(at)
        norm = problem.norm(tried)
        if norm < least:
            least, best = norm, (at, tried, slope)
        if norm < (1 - 0.1 * length) * start:
            break
        length *= 0.5
    return best
