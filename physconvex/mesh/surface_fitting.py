"""Fits coarse meshes to a surface, or to a volume, while their elements stay well shaped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from physconvex.mesh.tet_mesh import TetMesh, mean_ratios, to_quadratic
from physconvex.numerics import closest_in_triangles

# Edges of a regular tetrahedron as columns, inverted: maps the edges of an element to a deformation gradient.
REGULAR_INVERSE = np.linalg.inv(
    np.array([[1.0, 0.5, 0.5], [0.0, np.sqrt(3) / 2, np.sqrt(3) / 6], [0.0, 0.0, np.sqrt(2 / 3)]])
)
# Weight of the squared distances (relative to the element size) against the mean element distortion.
DISTANCE_WEIGHT = 40.0
# L-BFGS steps per pairing, and steps to a volume.
ITERATIONS, VOLUME_STEPS = 12, 5
# Triangles tried for each surface point, nearest centres first.
CANDIDATES = 16


def fit_to_surface(
    mesh: TetMesh, points: Float[np.ndarray, "S 3"], normals: Float[np.ndarray, "S 3"], *, rounds: int = 6
) -> TetMesh:
    """Move all nodes so that the boundary follows a surface and the elements stay close to regular.

    Alternates between pairing (boundary nodes with their nearest surface points, surface points with their nearest
    boundary triangles) and L-BFGS on the point-to-plane distances of the pairs plus the distortion tr(FᵀF) / (3
    det(F)^(2/3)) of the elements (Knupp 2001), which is infinite for flat ones.

    Args:
        mesh: linear mesh near the surface, elements positive.
        points: points of the surface [m].
        normals: outward unit normals there.
        rounds: number of pairings.
    """
    scale = float(np.cbrt(mesh.element_volumes.mean() * 6 * np.sqrt(2)))
    tree, faces, x = cKDTree(points), mesh.boundary_faces, mesh.vertices.copy()
    nodes = np.unique(faces)
    for _ in range(rounds):
        nearest = tree.query(x[nodes])[1]
        triangle, weight = _nearest_on_boundary(x[faces], points)
        outward = np.concatenate([normals[nearest], normals])
        terms = _PlaneTerms(
            nodes=np.concatenate([np.column_stack([nodes] * 3), faces[triangle]]),
            weights=np.concatenate([np.tile([1.0, 0.0, 0.0], (len(nodes), 1)), weight]),
            normals=outward,
            offsets=np.einsum("na,na->n", outward, np.concatenate([points[nearest], points])),
            factors=np.concatenate([np.full(len(nodes), 0.5 / len(nodes)), np.full(len(points), 0.5 / len(points))]),
        )
        result = minimize(
            _objective,
            x.ravel(),
            args=(mesh.tets, terms, scale),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": ITERATIONS, "maxcor": 20},
        )
        candidate = result.x.reshape(-1, 3)
        if not np.isfinite(result.fun) or result.fun >= INVERTED:
            break
        x = candidate
    return TetMesh(x, mesh.tets)


INVERTED = 1e12


@dataclass(frozen=True)
class _PlaneTerms:
    """Squared distances of weighted triples of nodes from planes with these unit normals and offsets [m]."""

    nodes: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    factors: np.ndarray

    def value(self, x: np.ndarray, scale: float, gradient: np.ndarray) -> float:
        """Weighted mean of the squared distances; adds the derivative to `gradient`."""
        place = np.einsum("nk,nka->na", self.weights, x[self.nodes])
        distance = (np.einsum("na,na->n", self.normals, place) - self.offsets) / scale
        slope = (2 * DISTANCE_WEIGHT / scale * self.factors * distance)[:, None] * self.normals
        shares = self.weights[:, :, None] * slope[:, None]
        for a in range(3):
            gradient[:, a] += np.bincount(self.nodes.ravel(), shares[..., a].ravel(), minlength=len(x))
        return float(DISTANCE_WEIGHT * (self.factors * distance**2).sum())


def _objective(flat: np.ndarray, tets: np.ndarray, terms: _PlaneTerms, scale: float) -> tuple[float, np.ndarray]:
    x = flat.reshape(-1, 3)
    gradient = np.zeros_like(x)
    value = _distortion(x, tets, gradient)
    if value >= INVERTED:
        return INVERTED, gradient.ravel()
    return value + terms.value(x, scale, gradient), gradient.ravel()


def _distortion(x: np.ndarray, tets: np.ndarray, gradient: np.ndarray) -> float:
    """Mean of tr(FᵀF) / (3 det(F)^(2/3)) over the elements; adds the derivative to `gradient`."""
    edges = np.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)  # columns
    f = edges @ REGULAR_INVERSE
    a, b, c = np.moveaxis(f, 2, 0)
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    determinant = np.einsum("ea,ea->e", a, cofactor[:, :, 0])
    if determinant.min() <= 0:
        return INVERTED
    trace, power = np.einsum("eab,eab->e", f, f), determinant ** (-2 / 3)
    value = trace * power / 3
    slope = (2 / 3) * (power[:, None, None] * f - (value / determinant)[:, None, None] * cofactor)
    per_edge = np.swapaxes(slope @ REGULAR_INVERSE.T, 1, 2) / len(tets)  # [E, edge, axis]
    corners = np.concatenate([-per_edge.sum(axis=1, keepdims=True), per_edge], axis=1)
    for axis in range(3):
        gradient[:, axis] += np.bincount(tets.ravel(), corners[..., axis].ravel(), minlength=len(x))
    return float(value.mean())


def _nearest_on_boundary(triangles: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index [S] of the nearest triangle and barycentric coordinates [S, 3] of the nearest point in it."""
    count = min(CANDIDATES, len(triangles))
    near = cKDTree(triangles.mean(axis=1)).query(points, k=[*range(1, count + 1)])[1]
    weights = closest_in_triangles(triangles[near], points[:, None])
    gaps = np.linalg.norm(np.einsum("sck,scka->sca", weights, triangles[near]) - points[:, None], axis=2)
    best, rows = gaps.argmin(axis=1), np.arange(len(points))
    return near[rows, best], weights[rows, best]


def with_volume(mesh: TetMesh, volume: float) -> TetMesh:
    """`mesh` with its boundary moved along the normals until it encloses `volume` [m³].

    Steps that make an element flatter than half its previous mean ratio are shortened, so that the volume is reached as
    far as the elements permit.
    """
    corners = mesh.corner_tets
    nodes, tets = np.unique(corners, return_inverse=True)
    linear = TetMesh(mesh.vertices[nodes], tets.reshape(-1, 4))
    faces = linear.boundary_faces[:, :3]
    x = linear.vertices.copy()
    floor = np.minimum(0.5 * mean_ratios(x, linear.tets), 0.2)
    for _ in range(VOLUME_STEPS):
        current = np.linalg.det(x[linear.tets[:, 1:]] - x[linear.tets[:, :1]]).sum() / 6.0
        if abs(current / volume - 1) < 1e-6:
            break
        normals = _area_normals(x, faces)
        area = np.linalg.norm(normals, axis=1)
        direction = normals / np.maximum(area, np.finfo(float).tiny)[:, None]
        step = (volume - current) / max(area.sum(), np.finfo(float).tiny)
        while np.any(mean_ratios(x + step * direction, linear.tets) < floor) and abs(step) > 1e-9 * linear.size:
            step *= 0.5
        x = x + step * direction
    moved = TetMesh(x, linear.tets)
    return to_quadratic(moved) if mesh.order == 2 else moved


def _area_normals(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Outward area vector of each node, a third of those of its faces: the gradient of the volume."""
    cross = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]) / 6.0
    normals = np.zeros_like(x)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], cross)
    return normals
