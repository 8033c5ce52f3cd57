"""The equation of the contact forces of some points, and Newton's step for it.

With y the positions of the points without forces, S = B H Bᵀ their compliance and ρ the inverse of a point's own
compliance, the forces satisfy λ = R(y − S λ + λ/ρ). R is the resolvent of the law of contact
(`physconvex.dynamics.contact_resolvent`; Alart and Curnier 1991; Jourdan, Alart and Jean 1998).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import bsr_matrix, csr_matrix, identity, kron

from physconvex.dynamics import Contact, resolve


@dataclass(frozen=True)
class CarriedPoints:
    """C points that M nodes carry, in a time step.

    Attributes:
        free: y, their positions without forces [m].
        base: their velocities are their distances from here over the step [m].
        carried: B, from the nodes to the points, shape [C, M].
        compliance: H of the nodes [m/N], N = 3 M, symmetric.
        step: [s].
        time: at the end of the step [s].
    """

    free: Float[np.ndarray, "C 3"]
    base: Float[np.ndarray, "C 3"]
    carried: csr_matrix
    compliance: Float[np.ndarray, "N N"]
    step: float
    time: float

    def select(self, rows: Int[np.ndarray, " D"]) -> CarriedPoints:
        """Those points, with repetitions."""
        return replace(self, free=self.free[rows], base=self.base[rows], carried=self.carried[rows])


class ContactProblem:
    """λ − R(y − S λ + λ/ρ) of C pairs of a point and an obstacle, and its derivative.

    Args:
        law: of contact.
        points: of the pairs, shape [C].
        obstacles: their numbers in the law, shape [C].
        at: positions and compliance of the pairs' points.
    """

    def __init__(
        self, law: Contact, points: Int[np.ndarray, " C"], obstacles: Int[np.ndarray, " C"], at: CarriedPoints
    ) -> None:
        self.law, self.areas, self.obstacles = law, law.areas[points], obstacles
        self.free, self.base, self.step, self.time = at.free, at.base, at.step, at.time
        self.carried, self.compliance = at.carried, at.compliance
        own = np.maximum(self._own_compliance(), np.finfo(float).tiny)  # a pinned point has none
        self.stiffness = 3.0 / own  # ρ

    def _own_compliance(self) -> Float[np.ndarray, " C"]:
        """Trace of each point's own block of S [m/N]."""
        count = self.carried.shape[1]
        traces = np.einsum("nimi->nm", self.compliance.reshape(count, 3, count, 3))
        return np.asarray(self.carried.multiply(self.carried @ traces).sum(axis=1)).ravel()

    def size(self, left: Float[np.ndarray, "C 3"]) -> float:
        """Error of the forces, as a length [m]."""
        return float(np.abs(left / self.stiffness[:, None]).max())

    def norm(self, left: Float[np.ndarray, "C 3"]) -> float:
        """The mean error [m], which the iteration reduces."""
        return float(np.linalg.norm(left / self.stiffness[:, None]))

    def residual(self, forces: Float[np.ndarray, "C 3"]) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3 3"]]:
        """λ − R, and D, the derivative of R by its argument."""
        moved = (self.compliance @ (self.carried.T @ forces).ravel()).reshape(-1, 3)
        place = self.free - self.carried @ moved
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

    def newton_step(
        self, left: Float[np.ndarray, "C 3"], slope: Float[np.ndarray, "C 3 3"]
    ) -> Float[np.ndarray, "C 3"]:
        """Change δ of the forces, (1 − D/ρ + D S) δ = −left with D = `slope`.

        Solved for m = H Bᵀ δ at the nodes that carry touching points, since many points may depend on few nodes: with A
        = 1 − D/ρ, (1 + H Bᵀ A⁻¹ D B) m = −H Bᵀ A⁻¹ left and δ = −A⁻¹ (left + D B m). Forces of pairs that do not touch
        become zero immediately.
        """
        inverse = np.linalg.inv(np.eye(3) - slope / self.stiffness[:, None, None])
        alone = -(inverse @ left[:, :, None])[:, :, 0]
        stiff = inverse @ slope
        active = np.unique(self.carried[stiff.any(axis=(1, 2))].indices)
        if not len(active):
            return alone
        weights = kron(self.carried[:, active], identity(3), format="csr")
        stiff = bsr_matrix((stiff, np.arange(len(stiff)), np.arange(len(stiff) + 1))).tocsr()
        own = (weights.T @ stiff @ weights).tocsr()
        dofs = (3 * active[:, None] + np.arange(3)).ravel()
        matrix = np.eye(len(dofs)) + (own.T @ self.compliance[np.ix_(dofs, dofs)]).T
        right = self.compliance[dofs] @ (self.carried.T @ alone).ravel()
        return np.asarray(alone - (stiff @ (weights @ np.linalg.solve(matrix, right))).reshape(-1, 3))
