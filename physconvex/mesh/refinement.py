"""Refinement of tetrahedral meshes: everywhere, or locally, by bisection of longest edges."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.mesh.tet_mesh import TetMesh, linear_part, mesh_edges, node_count, oriented, to_quadratic

_EQUAL = 1.0 + 1e-9  # ratio of lengths up to which edges count as equally long
# The eight children of a tetrahedron in terms of its ten quadratic nodes (Bey's red refinement).
CHILDREN = np.array(
    [[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3], [4, 6, 7, 8], [4, 5, 6, 8], [6, 7, 8, 9], [5, 6, 8, 9]]
)


def refine_uniformly(mesh: TetMesh) -> TetMesh:
    """Each tetrahedron split into eight (Bey 1995); same geometry, same order; a filling is dropped."""
    quadratic = to_quadratic(TetMesh(mesh.vertices, mesh.tets) if mesh.order == 1 else linear_part(mesh))
    children = quadratic.tets[:, CHILDREN].reshape(-1, 4)
    fine = TetMesh(quadratic.vertices, oriented(quadratic.vertices, children))
    return fine if mesh.order == 1 else to_quadratic(fine)


def refine_locally(mesh: TetMesh, spacing: Float[np.ndarray, " V"], *, max_nodes: int) -> TetMesh:
    """The same geometry with bisected edges, in the order of their length in units of the wanted spacing.

    Every tetrahedron at a bisected edge is split into two, so that the mesh stays conforming. The bisected edge is the
    longest one of all tetrahedra around it: starting at the wanted edge, longer neighbours are followed to the end
    (longest-edge propagation path, Rivara 1997), which prevents flat elements.

    Args:
        mesh: of either order.
        spacing: wanted edge length at each node of `mesh`, in any unit; linear between nodes.
        max_nodes: upper bound on the nodes of the result, which has the order of `mesh`.

    Raises:
        InputError: a spacing is missing or not positive.
    """
    if spacing.shape != (len(mesh.vertices),) or not (spacing > 0).all():
        raise InputError(f"spacing: got shape {spacing.shape}; expected one positive length for each of the nodes")
    best = linear_part(mesh)
    spacing = spacing[np.unique(mesh.corner_tets)]  # in the order of `linear_part`
    vertices, tets = best.vertices, best.tets
    while node_count(vertices, tets, mesh.order) <= max_nodes:
        best = TetMesh(vertices, tets)
        vertices, tets, spacing = _bisected(vertices, tets, spacing)
    return to_quadratic(best) if mesh.order == 2 else best


def _bisected(vertices: np.ndarray, tets: np.ndarray, spacing: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, tetrahedra and spacings after one bisection."""
    edges, of_tet = mesh_edges(tets)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    edge = int(np.argmax(length / spacing[edges].mean(axis=1)))
    while True:
        around = np.flatnonzero((of_tet == edge).any(axis=1))
        candidates = of_tet[around].ravel()
        longest = int(candidates[np.argmax(length[candidates])])
        if length[longest] <= _EQUAL * length[edge]:
            break
        edge = longest
    first, second = edges[edge]
    near, far = tets[around].copy(), tets[around].copy()
    near[near == second] = far[far == first] = len(vertices)
    tets = np.concatenate([np.delete(tets, around, axis=0), near, far])
    middle = vertices[[first, second]].mean(axis=0)
    return np.vstack([vertices, middle]), tets, np.append(spacing, spacing[[first, second]].mean())
