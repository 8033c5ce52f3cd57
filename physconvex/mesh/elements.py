"""Shape functions and quadrature of linear and quadratic tetrahedra, in barycentric coordinates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.mesh.tet_mesh import EDGE_CORNERS

_A, _B = (5 + 3 * np.sqrt(5)) / 20, (5 - np.sqrt(5)) / 20


def _keast_degree_4() -> tuple[np.ndarray, np.ndarray]:
    """Eleven points, degree 4 (Keast 1986, rule 4 of the 11-point family)."""
    near_corners = np.where(np.eye(4) > 0, 0.7857142857142857, 0.07142857142857143)
    near_edges = np.full((6, 4), 0.10059642383320080)
    np.put_along_axis(near_edges, EDGE_CORNERS, 0.39940357616679920, axis=1)
    weights = np.repeat([-0.01315555555555556, 0.007622222222222222, 0.02488888888888889], [1, 4, 6])
    return np.vstack([np.full((1, 4), 0.25), near_corners, near_edges]), 6 * weights


# degree -> (barycentric points [Q, 4], weights [Q] that sum to one)
QUADRATURE: dict[int, tuple[Float[np.ndarray, "Q 4"], Float[np.ndarray, " Q"]]] = {
    1: (np.full((1, 4), 0.25), np.ones(1)),
    2: (np.where(np.eye(4) > 0, _A, _B), np.full(4, 0.25)),
    4: _keast_degree_4(),
}


def shape_values(barycentric: Float[np.ndarray, "Q 4"], order: int) -> Float[np.ndarray, "Q n"]:
    """Values of the 4 or 10 shape functions at the given points."""
    b = np.asarray(barycentric, dtype=np.float64)
    if order == 1:
        return b
    return np.hstack([b * (2 * b - 1), 4 * b[:, EDGE_CORNERS[:, 0]] * b[:, EDGE_CORNERS[:, 1]]])


def shape_gradients(barycentric: Float[np.ndarray, "Q 4"], order: int) -> Float[np.ndarray, "Q n 4"]:
    """Derivatives of the shape functions with respect to the four barycentric coordinates."""
    b = np.asarray(barycentric, dtype=np.float64)
    if order == 1:
        return np.broadcast_to(np.eye(4), (len(b), 4, 4)).copy()
    gradients = np.zeros((len(b), 10, 4))
    for i in range(4):
        gradients[:, i, i] = 4 * b[:, i] - 1
    for n, (i, j) in enumerate(EDGE_CORNERS, start=4):
        gradients[:, n, i] = 4 * b[:, j]
        gradients[:, n, j] = 4 * b[:, i]
    return gradients


def barycentric_gradients(corners: Float[np.ndarray, "E 4 3"]) -> Float[np.ndarray, "E 4 3"]:
    """∂b/∂X of tetrahedra with straight edges [1/m]."""
    inner = np.linalg.inv(corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)  # rows: ∂b_1..3/∂X
    return np.concatenate([-inner.sum(1, keepdims=True), inner], axis=1)


def unit_mass(order: int) -> Float[np.ndarray, "n n"]:
    """∫ N_a N_b dV over an element of volume one."""
    barycentric, weights = QUADRATURE[2 if order == 1 else 4]
    values = shape_values(barycentric, order)
    return np.asarray(np.einsum("q,qa,qb->ab", weights, values, values))
