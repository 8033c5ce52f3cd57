"""Tractions on the surface as forces on the nodes, consistent with the shape functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from physconvex.errors import InputError
from physconvex.mesh import TetMesh

Selector = Bool[np.ndarray, " F"] | Int[np.ndarray, " n"] | Callable[[Float[np.ndarray, "F 3"]], Bool[np.ndarray, " F"]]
Traction = Sequence[float] | Float[np.ndarray, "..."] | Callable[[Float[np.ndarray, "P 3"]], Float[np.ndarray, "P 3"]]


def _triangle_rule_degree_4() -> tuple[Float[np.ndarray, "Q 3"], Float[np.ndarray, " Q"]]:
    """Six points, degree 4 (Dunavant 1985, table II, p = 4); weights sum to one."""
    inner, weights = (0.445948490915965, 0.091576213509771), (0.223381589678011, 0.109951743655322)
    return np.concatenate([np.where(np.eye(3) > 0, 1 - 2 * a, a) for a in inner]), np.repeat(weights, 3)


def _triangle_shapes(b: np.ndarray, order: int) -> np.ndarray:
    """Shape functions of a face, [Q, 3] or [Q, 6] (corners, then the middles of the edges 01, 12, 20)."""
    return b if order == 1 else np.hstack([b * (2 * b - 1), 4 * b * np.roll(b, -1, axis=1)])


def _select(mesh: TetMesh, faces: Selector) -> np.ndarray:
    count = len(mesh.boundary_faces)
    if callable(faces):
        faces = np.asarray(faces(mesh.vertices[mesh.boundary_faces[:, :3]].mean(axis=1)), dtype=bool)
    chosen = np.asarray(faces)
    if chosen.dtype == bool:
        if chosen.shape != (count,):
            raise InputError(f"faces: got a mask of shape {chosen.shape}; expected ({count},), one per boundary face")
        chosen = np.flatnonzero(chosen)
    if len(chosen) == 0:
        raise InputError("faces: got none; expected at least one boundary face (the selector sees centroids in metres)")
    if not np.issubdtype(chosen.dtype, np.integer) or chosen.min() < 0 or chosen.max() >= count:
        raise InputError(f"faces: expected indices 0..{count - 1} into mesh.boundary_faces; got {chosen}")
    return mesh.boundary_faces[chosen]


def surface_load(mesh: TetMesh, faces: Selector, traction: Traction) -> Float[np.ndarray, "V 3"]:
    """Forces on the nodes [N] equivalent in work to a traction on a part of the boundary.

    F_a = ∫ N_a t dA over the rest surface (a dead load), by a rule that is exact for tractions up to degree 3 on linear
    and degree 2 on quadratic faces.

    Args:
        mesh: rest mesh.
        faces: which of `mesh.boundary_faces`: mask [F], indices [n], or a function of centroids [F, 3] giving a mask.
        traction: force per area [Pa]: shape [3], one per chosen face [n, 3], or a function of points [P, 3].

    Raises:
        InputError: no face chosen, or a shape that does not fit.
    """
    chosen = _select(mesh, faces)
    points, weights = _triangle_rule_degree_4()
    corners = mesh.vertices[chosen[:, :3]]  # [n, 3, 3]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    at = np.einsum("qb,nbi->nqi", points, corners)
    if callable(traction):
        values = np.asarray(traction(at.reshape(-1, 3)), dtype=np.float64).reshape(at.shape)
    else:
        array = np.asarray(traction, dtype=np.float64)
        if array.shape not in ((3,), (len(chosen), 3)):
            raise InputError(f"traction: got shape {array.shape}; expected (3,) or ({len(chosen)}, 3)")
        values = np.broadcast_to(array if array.ndim == 1 else array[:, None], at.shape)
    local = np.einsum("q,qa,nqi,n->nai", weights, _triangle_shapes(points, mesh.order), values, areas)
    forces = np.zeros_like(mesh.vertices)
    np.add.at(forces, chosen, local)
    return forces
