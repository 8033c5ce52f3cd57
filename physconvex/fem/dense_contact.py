"""Contact forces on the points that touch, from where the points would be without them and their compliance.

The equation λ = c(y − S λ) is solved by a semi-smooth Newton method on its form with a resolvent
(`physconvex.contact_resolvent`): λ = R(y − S λ + λ/ρ), ρ the inverse of a point's own compliance (Alart and Curnier
1991; Jourdan, Alart and Jean 1998).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.contact import Contact
from physconvex.contact_resolvent import resolve
from physconvex.errors import ConvergenceError

__all__ = ["DenseContact"]

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
        self.points = np.zeros(0, dtype=np.int64)  # that touch, or would without the forces
        self._of_pair = self._obstacle = self.points  # a pair is one of them and an obstacle

    def find(self, x: Float[np.ndarray, "S 3"], moved: Float[np.ndarray, "S 3"], time: float) -> None:
        """Look which points touch at x, at `moved` [m], or did when last solved for."""
        nodes, found = self.law.nodes, []
        for number, obstacle in enumerate(self.law.obstacles):
            near = (obstacle.gap(x[nodes], time) < 0) | (obstacle.gap(moved[nodes], time) < 0)
            found.append(np.union1d(nodes[near], np.flatnonzero(self._forces[number].any(axis=1))))
        pairs = np.concatenate([*found, self.points[:0]])
        self.points, self._of_pair = np.unique(pairs, return_inverse=True)
        self._obstacle = np.repeat(np.arange(len(found)), [len(part) for part in found])

    def total(self) -> Float[np.ndarray, "C 3"]:
        """Force on each of `points`, as a gradient [N]."""
        return self._forces[:, self.points].sum(axis=0)

    def solve(
        self,
        free: Float[np.ndarray, "C 3"],
        compliance: Float[np.ndarray, "N N"],
        base: Float[np.ndarray, "C 3"],
        step: float,
        time: float,
        *,
        goal: float,
    ) -> float:
        """Find the forces; the error that is left [m].

        Args:
            free: where `points` would be without forces [m].
            compliance: S [m/N], N = 3 C.
            base: their velocities are their distances from here over the step [m].
            step: [s].
            time: at the end of the step [s].
            goal: error asked for [m].

        Raises:
            ConvergenceError: not found.
        """
        of_pair = self._of_pair
        points = self.points[of_pair]
        if not np.array_equal(of_pair, np.arange(len(self.points))):  # more than one obstacle
            dofs = (3 * of_pair[:, None] + np.arange(3)).ravel()
            compliance = compliance[np.ix_(dofs, dofs)]
        problem = _Problem(
            self.law, points, self._obstacle, free[of_pair], compliance, base=base[of_pair], step=step, time=time
        )
        forces = self._forces[self._obstacle, points]
        left, slope = problem.evaluate(forces)
        for _ in range(_MOST):
            if (error := problem.size(left)) <= goal:
                self._forces[:] = 0.0
                self._forces[self._obstacle, points] = forces
                return error
            forces, left, slope = _searched(problem, forces, left, problem.newton_step(left, slope))
        raise ConvergenceError(f"the forces of contact are left off by {error:.3e} m")


class _Problem:
    """λ − R(y − S λ + λ/ρ) for some pairs of a point and an obstacle, and its derivative."""

    def __init__(
        self,
        law: Contact,
        points: np.ndarray,
        obstacles: np.ndarray,
        free: np.ndarray,
        compliance: np.ndarray,
        *,
        base: np.ndarray,
        step: float,
        time: float,
    ) -> None:
        self.law, self.obstacles, self.free, self.time = law, obstacles, free, time
        self.areas, self.base, self.step = law.areas[points], base, step
        own = compliance.diagonal().reshape(-1, 3).sum(axis=1)
        self.stiffness = 3.0 / np.maximum(own, np.finfo(float).tiny)  # ρ; a pinned point has no compliance
        self.compliance, self.less = compliance, compliance.copy()  # S, S − 1/ρ
        self.less.flat[:: len(compliance) + 1] -= np.repeat(1 / self.stiffness, 3)

    def size(self, left: np.ndarray) -> float:
        """Error of the forces, as a length [m]."""
        return float(np.abs(left / self.stiffness[:, None]).max())

    def norm(self, left: np.ndarray) -> float:
        return float(np.linalg.norm(left / self.stiffness[:, None]))

    def evaluate(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """λ − R [C, 3], and the derivative of R by its argument [C, 3, 3]."""
        place = self.free - (self.compliance @ forces.ravel()).reshape(-1, 3)
        left, slope = forces.copy(), np.zeros((len(forces), 3, 3))
        give = forces / self.stiffness[:, None]
        for number, obstacle in enumerate(self.law.obstacles):
            own = self.obstacles == number
            normals = obstacle.normals(place[own], self.time)
            depth = -obstacle.gap(place[own], self.time) - (give[own] * normals).sum(1)
            slip = (place[own] + give[own] - self.base[own]) / self.step - obstacle.velocity_at(self.time)
            found = resolve(
                self.law,
                obstacle.friction,
                areas=self.areas[own],
                normals=normals,
                depth=depth,
                slip=slip - (slip * normals).sum(1, keepdims=True) * normals,
                stiffness=self.stiffness[own],
                step=self.step,
            )
            left[own] -= found.force
            slope[own] = found.slope
        return left, slope

    def newton_step(self, left: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Change of the forces; those of pairs that do not touch go to zero at once."""
        touching = slope.any(axis=(1, 2))
        rows, others = np.flatnonzero(np.repeat(touching, 3)), np.flatnonzero(np.repeat(~touching, 3))
        step = -left.ravel()
        moved = (
            slope[touching] @ self.less[rows].reshape(-1, 3, len(step)) if len(rows) else np.zeros((0, 3, len(step)))
        )
        matrix = moved.reshape(len(rows), len(step))
        right = step[rows] - matrix[:, others] @ step[others]
        step[rows] = np.linalg.solve(np.eye(len(rows)) + matrix[:, rows], right)
        return step.reshape(-1, 3)


def _searched(
    problem: _Problem, forces: np.ndarray, left: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best of a few lengths of a step: forces, what is left, and the slope there."""
    start, length, least = problem.norm(left), 1.0, np.inf
    best = forces, left, np.zeros((len(forces), 3, 3))
    for _ in range(_HALVINGS):
        at = forces + length * step
        tried, slope = problem.evaluate(at)
        norm = problem.norm(tried)
        if norm < least:
            least, best = norm, (at, tried, slope)
        if norm < (1 - 0.1 * length) * start:
            break
        length *= 0.5
    return best
