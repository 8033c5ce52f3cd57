"""Contact forces on the points that touch, from where the points would be without them and their compliance.

The equation λ = c(y − S λ) is solved by a semi-smooth Newton method on its form with a resolvent
(`physconvex.contact_resolvent`): λ = R(y − S λ + λ/ρ), ρ the inverse of a point's own compliance (Alart and Curnier
1991; Jourdan, Alart and Jean 1998).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.sparse import bsr_matrix, csr_matrix

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
        carried: csr_matrix,
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
            carried: B, takes the nodes that carry `points` to them, shape [C, M].
            compliance: H of those nodes [m/N], N = 3 M.
            base: their velocities are their distances from here over the step [m].
            step: [s].
            time: at the end of the step [s].
            goal: error asked for [m].

        Raises:
            ConvergenceError: not found.
        """
        of_pair = self._of_pair
        points = self.points[of_pair]
        problem = _Problem(
            self.law, points, self._obstacle, free[of_pair], carried[of_pair], compliance,
            base=base[of_pair], step=step, time=time,
        )  # fmt: skip
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
        carried: csr_matrix,
        compliance: np.ndarray,
        *,
        base: np.ndarray,
        step: float,
        time: float,
    ) -> None:
        self.law, self.obstacles, self.free, self.time = law, obstacles, free, time
        self.areas, self.base, self.step = law.areas[points], base, step
        self.carried, self.compliance = carried, compliance  # S = B H Bᵀ
        count = carried.shape[1]
        traces = np.einsum("nimi->nm", compliance.reshape(count, 3, count, 3))
        own = np.asarray(carried.multiply(carried @ traces).sum(axis=1)).ravel()
        self.stiffness = 3.0 / np.maximum(own, np.finfo(float).tiny)  # ρ; a pinned point has no compliance

    def moved(self, forces: np.ndarray) -> np.ndarray:
        """S λ [m]."""
        return np.asarray(self.carried @ (self.compliance @ (self.carried.T @ forces).ravel()).reshape(-1, 3))

    def size(self, left: np.ndarray) -> float:
        """Error of the forces, as a length [m]."""
        return float(np.abs(left / self.stiffness[:, None]).max())

    def norm(self, left: np.ndarray) -> float:
        return float(np.linalg.norm(left / self.stiffness[:, None]))

    def evaluate(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """λ − R [C, 3], and the derivative of R by its argument [C, 3, 3]."""
        place = self.free - self.moved(forces)
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
        """Change δ of the forces, (1 − D/ρ + D S) δ = −left with D = `slope`.

        Solved for in Bᵀ δ, of the nodes that carry points that touch: many points may stand on few nodes. Forces of
        pairs that do not touch go to zero at once.
        """
        inverse = np.linalg.inv(np.eye(3) - slope / self.stiffness[:, None, None])
        alone = -(inverse @ left[:, :, None])[:, :, 0]
        stiff = inverse @ slope
        active, own = self._on_carriers(stiff)
        if not len(active):
            return alone
        dofs = (3 * active[:, None] + np.arange(3)).ravel()
        matrix = (own.T @ self.compliance[np.ix_(dofs, dofs)]).T  # both of them times each other, H being symmetric
        matrix.flat[:: len(dofs) + 1] += 1.0
        right = self.compliance[dofs] @ (self.carried.T @ alone).ravel()
        moved = np.zeros((self.carried.shape[1], 3))
        moved[active] = np.linalg.solve(matrix, right).reshape(-1, 3)
        return alone - (stiff @ (self.carried @ moved)[:, :, None])[:, :, 0]

    def _on_carriers(self, stiff: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
        """Which nodes carry pairs that touch, and Bᵀ (1 − D/ρ)⁻¹ D B among them."""
        count = self.carried.shape[1]
        gather, first, second = self._pairs_of_carriers
        touched = np.zeros(count, dtype=bool)
        touched[self.carried[stiff.any(axis=(1, 2))].indices] = True
        number = np.cumsum(touched) - 1
        kept = touched[first] & touched[second]
        rows = number[first[kept]]
        starts = np.searchsorted(rows, np.arange(touched.sum() + 1))
        blocks = (gather[np.flatnonzero(kept)] @ stiff.reshape(-1, 9)).reshape(-1, 3, 3)
        size = 3 * int(touched.sum())
        own = bsr_matrix((blocks, number[second[kept]], starts), shape=(size, size))
        return np.flatnonzero(touched), own.tocsr()  # times a dense matrix twice as fast as by blocks

    @cached_property
    def _pairs_of_carriers(self) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
        """For each two nodes that carry a point in common: products of their weights by point, and which they are."""
        counts = np.diff(self.carried.indptr)
        point = np.repeat(np.arange(len(counts)), counts)
        slot = np.arange(len(point)) - np.repeat(self.carried.indptr[:-1], counts)
        node, weight = np.zeros((2, len(counts), int(counts.max(initial=0))))
        node[point, slot], weight[point, slot] = self.carried.indices, self.carried.data
        keys = (node[:, :, None] * self.carried.shape[1] + node[:, None, :]).astype(np.int64)
        products = weight[:, :, None] * weight[:, None, :]
        where = products != 0
        found, place = np.unique(keys[where], return_inverse=True)
        columns = np.broadcast_to(np.arange(len(counts))[:, None, None], keys.shape)[where]
        gather = csr_matrix((products[where], (place, columns)), shape=(len(found), len(counts)))
        return gather, found // max(self.carried.shape[1], 1), found % max(self.carried.shape[1], 1)


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
