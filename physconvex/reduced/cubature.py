"""Samples of a body: interior points with volumes, surface points with areas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import roots_jacobi

from physconvex.errors import InputError
from physconvex.mesh import QUADRATURE, TetMesh

_QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])  # of a quadratic face
MASS_DEGREE = 6  # (quadratic weight × X)² within an element


@dataclass(frozen=True)
class Cubature:
    """Points whose weighted sum approximates an integral over the body.

    Attributes:
        points: rest positions [m], shape [Q, 3].
        weights: volumes [m³], shape [Q], positive.
        cells: cell of each point, shape [Q]: its tetrahedron, or the point itself without a mesh. Material constants
            are given per cell.
        cell_count: number of cells.

    Raises:
        InputError: shapes that do not fit, weights that are not positive.
    """

    points: Float[np.ndarray, "Q 3"]
    weights: Float[np.ndarray, " Q"]
    cells: Int[np.ndarray, " Q"]
    cell_count: int

    def __post_init__(self) -> None:
        points, weights = np.asarray(self.points, dtype=np.float64), np.asarray(self.weights, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise InputError(f"points: got shape {points.shape}; expected finite [Q, 3] in metres, Q > 0")
        if weights.shape != (len(points),) or not (np.isfinite(weights) & (weights > 0)).all():
            raise InputError(f"weights: got shape {weights.shape}; expected [{len(points)}] volumes > 0 in m³")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "weights", weights)

    @property
    def volume(self) -> float:
        """Volume of the body [m³]."""
        return float(self.weights.sum())


def _conical_rule(degree: int) -> tuple[Float[np.ndarray, "Q 4"], Float[np.ndarray, " Q"]]:
    """Conical product of Gauss–Jacobi rules (Stroud 1971, §3.1): any degree, positive weights that sum to one."""
    n = degree // 2 + 1
    (u, wu), (v, wv), (w, ww) = (((t + 1) / 2, f) for t, f in (roots_jacobi(n, power, 0) for power in (2, 1, 0)))
    b1 = np.broadcast_to(u[:, None, None], (n, n, n))
    b2 = np.broadcast_to((1 - u)[:, None, None] * v[:, None], (n, n, n))
    b3 = (1 - u)[:, None, None] * (1 - v)[:, None] * w
    weights = (wu[:, None, None] * wv[:, None] * ww).ravel()
    points = np.stack([1 - b1 - b2 - b3, b1, b2, b3], axis=-1).reshape(-1, 4)
    return points, weights / weights.sum()


def tet_cubature(mesh: TetMesh, *, degree: int = 2) -> Cubature:
    """Quadrature points of all tetrahedra, exact for polynomials of that degree within each; volume exact.

    Degree 1 takes one point per tetrahedron, 2 takes 4, 4 takes 27, 6 takes 64. A partly filled mesh
    (`physconvex.fem.filled`) uses its 4 points for degrees up to 2, and all points spread over the body for higher
    ones.

    Raises:
        InputError: `degree` is not in 1..12.
    """
    if not 1 <= degree <= 12:
        raise InputError(f"degree: got {degree}; expected 1 to 12")
    part = mesh.filling
    if part is not None and degree > 2:
        return Cubature(part.points, np.full(len(part.points), part.share), part.cells, len(mesh.tets))
    if part is not None:
        points = part.barycentric @ mesh.vertices[mesh.corner_tets]
        cells = np.repeat(np.arange(len(mesh.tets)), points.shape[1])
        return Cubature(points.reshape(-1, 3), part.weights.ravel(), cells, len(mesh.tets))
    barycentric, weights = QUADRATURE[degree] if degree <= 2 else _conical_rule(degree)
    points = np.einsum("qb,ebi->eqi", barycentric, mesh.vertices[mesh.corner_tets])
    volumes = mesh.element_volumes[:, None] * weights
    cells = np.repeat(np.arange(len(mesh.tets)), len(weights))
    return Cubature(points.reshape(-1, 3), volumes.ravel(), cells, len(mesh.tets))


@dataclass(frozen=True)
class Shell:
    """A closed surface of triangles, counter-clockwise from outside.

    Attributes:
        points: rest positions of the vertices [m], shape [V, 3].
        faces: shape [F, 3].

    Raises:
        InputError: wrong shapes, indices out of range, or a surface that is open or turned inside out.
    """

    points: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]

    def __post_init__(self) -> None:
        points, faces = np.asarray(self.points, dtype=np.float64), np.asarray(self.faces, dtype=np.int64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"shell.points: got shape {points.shape}; expected finite [V, 3] in metres")
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.min() < 0 or faces.max() >= len(points):
            raise InputError(
                f"shell.faces: got shape {faces.shape}; expected [F, 3], indices of {len(points)} vertices"
            )
        corners = points[faces] - points.mean(0)
        volume = float(np.linalg.det(corners).sum()) / 6
        if not volume > 0:
            raise InputError(f"shell: its faces enclose {volume:.3g} m³; expected a closed surface, normals outwards")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "faces", faces)

    @classmethod
    def of_mesh(cls, mesh: TetMesh) -> Shell:
        """The boundary of a tetrahedral mesh; every face of a quadratic one is split into four."""
        faces = mesh.boundary_faces
        if mesh.order == 2:
            faces = faces[:, _QUARTERS].reshape(-1, 3)
        used, faces = np.unique(faces, return_inverse=True)
        return cls(mesh.vertices[used], faces.reshape(-1, 3))


@dataclass(frozen=True)
class BodySamples:
    """All samples of one body.

    Attributes:
        interior: for the elastic energy.
        mass: for mass and volume, of a higher degree.
        surface_points: points at which contact and loads act, rest positions [m], shape [S, 3].
        surface_areas: boundary area of each of them [m²], shape [S].
        shell: triangles that points of other bodies must not cross; without it, no other body can touch this one.
    """

    interior: Cubature
    mass: Cubature
    surface_points: Float[np.ndarray, "S 3"]
    surface_areas: Float[np.ndarray, " S"]
    shell: Shell | None = None

    def __post_init__(self) -> None:
        points, areas = np.asarray(self.surface_points), np.asarray(self.surface_areas)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"surface_points: got shape {points.shape}; expected finite [S, 3] in metres")
        if areas.shape != (len(points),) or not (areas >= 0).all():
            raise InputError(f"surface_areas: got shape {areas.shape}; expected [{len(points)}] areas ≥ 0 in m²")
        if self.interior.cell_count != self.mass.cell_count:
            raise InputError(f"mass: got {self.mass.cell_count} cells; expected {self.interior.cell_count}")

    @property
    def size(self) -> float:
        """Largest edge of the bounding box of all samples [m]."""
        return float(np.ptp(np.concatenate([self.interior.points, self.surface_points]), axis=0).max())

    @classmethod
    def of_mesh(cls, mesh: TetMesh, *, degree: int = 2) -> BodySamples:
        """Samples of a tetrahedral body: all tetrahedra; the boundary nodes with their areas in the full model.

        Args:
            mesh: rest mesh, linear or quadratic.
            degree: of the rule for the elastic energy; one point per tetrahedron (1) biases ν (see design notes).
        """
        boundary = np.flatnonzero(mesh.node_areas > 0)
        return cls(
            interior=tet_cubature(mesh, degree=degree),
            mass=tet_cubature(mesh, degree=MASS_DEGREE),
            surface_points=mesh.vertices[boundary],
            surface_areas=mesh.node_areas[boundary],
            shell=Shell.of_mesh(mesh),
        )

    @classmethod
    def of_points(
        cls,
        points: Float[np.ndarray, "Q 3"],
        volumes: float | Float[np.ndarray, " Q"],
        *,
        surface_points: Float[np.ndarray, "S 3"] | None = None,
        surface_areas: Float[np.ndarray, " S"] | None = None,
    ) -> BodySamples:
        """Samples from arrays.

        Args:
            points: interior points [m], shape [Q, 3].
            volumes: volume of each [m³], shape [Q], or of all together.
            surface_points: boundary points [m]; without them nothing can touch the body.
            surface_areas: their areas [m²].
        """
        points = np.asarray(points, dtype=np.float64)
        weights = np.full(len(points), volumes / max(len(points), 1)) if np.ndim(volumes) == 0 else np.asarray(volumes)
        cubature = Cubature(points, weights, np.arange(len(points)), len(points))
        if (surface_points is None) != (surface_areas is None):
            raise InputError("surface_points, surface_areas: got one without the other; give both or none")
        shell = np.zeros((0, 3)) if surface_points is None else np.asarray(surface_points, dtype=np.float64)
        areas = np.zeros(0) if surface_areas is None else np.asarray(surface_areas, dtype=np.float64)
        return cls(cubature, cubature, shell, areas)
