"""Contact between two bodies: sampled points of one inside the triangles that bound the other.

A point x of body A with the area A_s, at the depth p inside body B under the nearest point q of its shell, has the
energy ½ A_s ψ(p) with the hinge of `Contact`. The other half comes from B's points inside A. With q = Σ_k b_k x_k(B), x
− q is linear in the coordinates of both bodies while q stays at one place of the shell. Since q is the nearest point,
the derivative of p is that at fixed q: force and reaction are equal, opposite, and on one line, which conserves
momentum and angular momentum. The Hessian omits the rotation of the normal (ψ' over the curvature of the distance), and
is therefore positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from physconvex.dynamics import Contact
from physconvex.numerics import closest_in_triangles

_TIE = 1e-9  # relative difference of distances below which triangles count as equally near


@dataclass(frozen=True)
class Touch:
    """Points of a body inside another one.

    Attributes:
        samples: their indices, shape [C].
        corners: vertices of the nearest triangle of the shell, shape [C, 3].
        shares: barycentric coordinates of the nearest point, shape [C, 3].
        depth: p [m], shape [C].
        normals: outwards from the shell, shape [C, 3].
    """

    samples: Int[np.ndarray, " C"]
    corners: Int[np.ndarray, "C 3"]
    shares: Float[np.ndarray, "C 3"]
    depth: Float[np.ndarray, " C"]
    normals: Float[np.ndarray, "C 3"]


_NO_TOUCH = Touch(
    np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))
)


@dataclass(frozen=True)
class _Nearest:
    """The nearest triangle of each of N points: barycentric coordinates of the nearest point, offset [m] from it,
    side of the shell, and distance [m].
    """

    faces: np.ndarray
    shares: np.ndarray
    offsets: np.ndarray
    inside: np.ndarray
    distances: np.ndarray


def _listed(rows: np.ndarray, entries: np.ndarray, count: int) -> np.ndarray:
    """The entries of each of so many rows, given sorted by rows; padded with the last one."""
    lengths = np.bincount(rows, minlength=count)
    starts = np.cumsum(lengths) - lengths
    width = np.arange(lengths.max(initial=1))
    return entries[starts[:, None] + np.minimum(width, lengths[:, None] - 1)]


@dataclass(frozen=True)
class FrozenPairs:
    """Friction between the bodies, frozen to a linear drag for one solve.

    Attributes:
        rows: x − q as a function of both bodies' coordinates, shape [C, R_A + R_B].
        weights: force over slip velocity [N·s/m], shape [C].
        normals: shape [C, 3].
    """

    rows: Float[np.ndarray, "C R"]
    weights: Float[np.ndarray, " C"]
    normals: Float[np.ndarray, "C 3"]

    def slip(self, velocity: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "C 3"]:
        """Tangential velocity of the points along the shell [m/s]."""
        relative = self.rows @ velocity
        return relative - (relative * self.normals).sum(1, keepdims=True) * self.normals

    def energy_and_gradient(self, velocity: Float[np.ndarray, "R 3"]) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Rate potential [W] and its derivative by the velocities of the coordinates [N]."""
        slip = self.slip(velocity)
        force = self.weights[:, None] * slip
        return 0.5 * float((force * slip).sum()), self.rows.T @ force

    @property
    def blocks(self) -> Float[np.ndarray, "C 3 3"]:
        """Derivative of the force by the relative velocity [N·s/m]."""
        return self.weights[:, None, None] * (np.eye(3) - self.normals[:, :, None] * self.normals[:, None, :])


class PairContact:
    """Points of one body against the shell of another one; joint coordinates of both, [R_A + R_B, 3].

    Args:
        law: hinge, slip velocity, and the areas of the points.
        friction: Coulomb coefficient [-].
        samples: shape functions of A at its points, shape [S, R_A].
        shell: shape functions of B at the vertices of its shell, shape [V, R_B].
        faces: of the shell, shape [F, 3].
        reach: approach of the bodies after which the triangles near a point are searched again [m].
    """

    def __init__(
        self,
        law: Contact,
        friction: float,
        samples: Float[np.ndarray, "S R"],
        shell: Float[np.ndarray, "V R"],
        faces: Int[np.ndarray, "F 3"],
        *,
        reach: float,
    ) -> None:
        self.law, self.coefficient, self.faces, self.reach = law, friction, faces, reach
        self.samples, self.shell = samples, shell
        self._split = samples.shape[1]
        self._seen: tuple[np.ndarray, np.ndarray] | None = None
        self._near = np.zeros(0, dtype=np.int64)  # points
        self._lists = np.zeros((0, 1), dtype=np.int64)  # faces near each of them
        self._clearances = np.zeros(0)  # distance of each outside at the last search [m], 0 inside

    # -- geometry

    def touching(self, y: Float[np.ndarray, "R 3"]) -> Touch:
        """The points of A inside B."""
        points, vertices = self.samples @ y[: self._split], self.shell @ y[self._split :]
        moved = np.inf if self._seen is None else self._moved(points, vertices)
        if moved > 0.5 * self.reach:
            self._look(points, vertices)
            moved = 0.0
        some = self._clearances <= moved
        if not some.any():
            return _NO_TOUCH
        near = self._near[some]
        found = self._nearest(points[near], self._lists[some], vertices)
        inside = found.inside
        outward, depth = -found.offsets[inside], found.distances[inside]
        normals = outward / np.maximum(depth, 1e-300)[:, None]
        return Touch(near[inside], self.faces[found.faces[inside]], found.shares[inside], depth, normals)

    def _nearest(self, points: np.ndarray, lists: np.ndarray, vertices: np.ndarray) -> _Nearest:
        """Nearest triangle of each point's list."""
        corners = vertices[self.faces[lists]]  # [N, K, 3, 3]
        shares = closest_in_triangles(corners, points[:, None])
        offset = points[:, None] - np.einsum("nkc,nkci->nki", shares, corners)
        square = (offset**2).sum(-1)
        near = square <= square.min(1, keepdims=True) * (1 + _TIE) + 1e-300
        # of triangles that meet at the nearest point, the one whose plane is farthest gives the side
        first, second, third = corners[near].swapaxes(0, 1)
        normals = np.cross(second - first, third - first)
        heights = np.zeros(near.shape)
        heights[near] = (offset[near] * normals).sum(1) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        at = np.arange(len(points)), np.where(near, np.abs(heights), -1.0).argmax(1)
        return _Nearest(lists[at], shares[at], offset[at], heights[at] < 0, np.sqrt(square[at]))

    def _moved(self, points: np.ndarray, vertices: np.ndarray) -> float:
        """Upper bound on the approach of points and shell since the last search [m]."""
        assert self._seen is not None
        drift = (points - self._seen[0]).mean(0)  # a common one changes no distance
        return sum(
            float(np.sqrt(((now - then - drift) ** 2).sum(1).max(initial=0.0)))
            for now, then in zip((points, vertices), self._seen, strict=True)
        )

    def _look(self, points: np.ndarray, vertices: np.ndarray) -> None:
        """Points that may move inside, and every triangle that may be their nearest one."""
        self._seen = (points, vertices)
        low, high = vertices.min(0) - self.reach, vertices.max(0) + self.reach
        self._near = np.flatnonzero(((points > low) & (points < high)).all(1))
        corners = vertices[self.faces]
        centres = corners.mean(1)
        radii = np.linalg.norm(corners - centres[:, None], axis=2).max(1)
        apart = cdist(points[self._near], centres)
        # by the triangles' balls, then by the triangles themselves; sorted by points
        numbers, faces = np.nonzero(apart - radii <= (apart + radii).min(1, keepdims=True) + self.reach)
        here = points[self._near[numbers]]
        shares = closest_in_triangles(corners[faces], here)
        distance = np.linalg.norm(here - np.einsum("nc,nci->ni", shares, corners[faces]), axis=1)
        least = np.full(len(self._near), np.inf)
        np.minimum.at(least, numbers, distance)
        kept = distance <= least[numbers] + self.reach
        self._lists = _listed(numbers[kept], faces[kept], len(self._near))
        found = self._nearest(points[self._near], self._lists, vertices)
        self._clearances = np.where(found.inside, 0.0, found.distances)
        keep = self._clearances <= self.reach  # the others cannot touch before the next search
        self._near, self._lists, self._clearances = self._near[keep], self._lists[keep], self._clearances[keep]

    def rows(self, touch: Touch) -> Float[np.ndarray, "C R"]:
        """x − q as a function of both bodies' coordinates."""
        nearest = np.einsum("nc,ncr->nr", touch.shares, self.shell[touch.corners])
        return np.hstack([self.samples[touch.samples], -nearest])

    # -- energy

    def energy_and_gradient(self, y: Float[np.ndarray, "R 3"]) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Energy [J] and its derivative by the coordinates of both bodies [N]."""
        touch = self.touching(y)
        if not len(touch.samples):
            return 0.0, np.zeros_like(y)
        energy, slope, _ = self.law.hinge(touch.depth)
        areas = 0.5 * self.law.areas[touch.samples]
        return float(areas @ energy), -(self.rows(touch).T @ ((areas * slope)[:, None] * touch.normals))

    def stiffness(self, y: Float[np.ndarray, "R 3"]) -> tuple[Float[np.ndarray, "C R"], Float[np.ndarray, "C 3 3"]]:
        """Rows and blocks of the positive Hessian Σ_c rowᵀ block row [N/m]."""
        touch = self.touching(y)
        curvature = 0.5 * self.law.areas[touch.samples] * self.law.hinge(touch.depth)[2]
        return self.rows(touch), curvature[:, None, None] * touch.normals[:, :, None] * touch.normals[:, None, :]

    def freeze(self, y: Float[np.ndarray, "R 3"], velocity: Float[np.ndarray, "R 3"]) -> FrozenPairs | None:
        """Friction linearised at coordinates [m] and velocities [m/s], as in `Contact.freeze_friction`."""
        if not self.coefficient:
            return None
        touch = self.touching(y)
        if not len(touch.samples):
            return None
        bare = FrozenPairs(self.rows(touch), np.zeros(len(touch.samples)), touch.normals)
        speed = np.linalg.norm(bare.slip(velocity), axis=1) / self.law.slip_velocity
        ratio = np.where(speed < 1, 2 - speed, 1 / np.maximum(speed, 1.0))  # f₁(s)/s
        limits = 0.5 * self.coefficient * self.law.areas[touch.samples] * self.law.hinge(touch.depth)[1]
        return FrozenPairs(bare.rows, limits * ratio / self.law.slip_velocity, touch.normals)
