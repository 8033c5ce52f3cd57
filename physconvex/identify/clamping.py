"""The held nodes of a mesh and their prescribed motion, from the boundary of a capture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from physconvex.dynamics import Pins
from physconvex.errors import InputError
from physconvex.fem import NodePins
from physconvex.io import Boundary
from physconvex.mesh import EDGE_CORNERS, FACE_CORNERS, TetMesh
from physconvex.numerics import closest_points

_NEIGHBOURS = 4
_NEAR = 12  # held triangles with the nearest centres, to which the distance of a point is computed
_REACH = 0.3  # edges of the mesh within which a corner counts as part of the held region


@dataclass(frozen=True, eq=False)
class Clamp:
    """Held nodes of a mesh.

    Attributes:
        mesh: the mesh.
        nodes: indices of the nodes, shape [C].
        motion: positions of the nodes [m] as a function of time [s], shape [C, 3]; None: the nodes stay at rest.
    """

    mesh: TetMesh
    nodes: Int[np.ndarray, " C"]
    motion: Callable[[float], Float[np.ndarray, "C 3"]] | None = None

    @property
    def held(self) -> Bool[np.ndarray, " V"]:
        """Which nodes of the mesh are held."""
        found = np.zeros(len(self.mesh.vertices), dtype=bool)
        found[self.nodes] = True
        return found

    def node_pins(self) -> NodePins:
        """For the full model: the nodes are prescribed."""
        return NodePins(self.nodes, self.motion)

    def springs(self) -> Pins:
        """For the reduced model: springs at the nodes that carry boundary area."""
        areas = self.mesh.node_areas[self.nodes]
        kept = np.flatnonzero(areas > 0)
        motion = self.motion
        led = None if motion is None else lambda time: motion(time)[kept]
        return Pins(self.mesh.vertices[self.nodes[kept]], areas[kept], motion=led)


def clamp_of(
    boundary: Boundary,
    mesh: TetMesh,
    *,
    reference: Float[np.ndarray, "R 3"],
    cells: Int[np.ndarray, "E k"] | None = None,
    fps: float,
) -> Clamp:
    """Transfer a boundary to the nodes of a mesh.

    Args:
        boundary: vertices of `reference`, or a box in the rest frame; their motion.
        mesh: mesh of the model, rest state. Its nodes need not coincide with those of the reference.
        reference: vertices [m] that the boundary indexes: of the capture's tetrahedra, else of its mesh.
        cells: tetrahedra [E, 4] or triangles [E, 3] of the reference; those with held vertices only are held.
        fps: frames per second of the motion; it is interpolated by cubic splines.

    Raises:
        InputError: an index out of range, or no node of the mesh is held.
    """
    held = _held_vertices(boundary, reference)
    nodes = _held_nodes(mesh, HeldRegion.of(reference, held, cells), boundary)
    if not (mesh.node_areas[nodes] > 0).any():
        raise InputError(
            "boundary: it holds no node of the surface; expected a box (rest frame, metres) or vertices that hold part "
            "of the body. Compare it with the bounding box "
            f"{mesh.vertices.min(0).round(4).tolist()} to {mesh.vertices.max(0).round(4).tolist()}"
        )
    if boundary.motion is None:
        return Clamp(mesh, nodes)
    if len(held) != boundary.motion.shape[1]:
        raise InputError(
            f"boundary: motion leads {boundary.motion.shape[1]} points, the box holds {len(held)} vertices; "
            "expected one row per held vertex, in their order"
        )
    return Clamp(mesh, nodes, _led(mesh.vertices[nodes], reference[held], boundary.motion, fps))


def _held_vertices(boundary: Boundary, reference: np.ndarray) -> np.ndarray:
    if boundary.clamped_box is not None:
        low, high = boundary.clamped_box
        return np.flatnonzero(((reference >= low) & (reference <= high)).all(1))
    assert boundary.clamped_vertices is not None
    if boundary.clamped_vertices.max() >= len(reference):
        raise InputError(
            f"boundary: clamped_vertices has {boundary.clamped_vertices.max()}; expected indices below "
            f"{len(reference)}, the vertices of tets.npz (else of the mesh)"
        )
    return boundary.clamped_vertices


def _held_nodes(mesh: TetMesh, region: HeldRegion, boundary: Boundary) -> Int[np.ndarray, " C"]:
    """Nodes in the box, corners in or near the held region, and mid-edge nodes between two held corners.

    The surface of a remeshed body differs from that of the reference by a fraction of an edge.
    """
    marked = np.zeros(len(mesh.vertices), bool)
    corners = np.unique(mesh.corner_tets)
    marked[corners] = region.holds(mesh.vertices[corners], reach=_REACH * _corner_edge(mesh))
    if boundary.clamped_box is not None:
        low, high = boundary.clamped_box
        marked |= ((mesh.vertices >= low) & (mesh.vertices <= high)).all(1)
    if mesh.order == 2:
        marked[mesh.tets[:, 4:]] |= marked[mesh.tets[:, EDGE_CORNERS]].all(-1)
    return np.flatnonzero(marked)


def _corner_edge(mesh: TetMesh) -> float:
    """Median length of the elements' edges [m]."""
    ends = mesh.vertices[mesh.corner_tets[:, EDGE_CORNERS]]
    return float(np.median(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1)))


def _led(
    nodes: np.ndarray, held: np.ndarray, motion: np.ndarray, fps: float
) -> Callable[[float], Float[np.ndarray, "C 3"]]:
    """The nodes follow the displacements of the nearest driven points, weighted by inverse square distance."""
    count = min(_NEIGHBOURS, len(held))
    distance, nearest = cKDTree(held).query(nodes, k=[*range(1, count + 1)])
    weights = 1.0 / np.maximum(distance, 1e-9 * (1 + np.ptp(held))) ** 2
    weights /= weights.sum(1, keepdims=True)
    displacement = np.einsum("ck,tcki->tci", weights, (motion - held)[:, nearest])
    if len(motion) < 2:
        fixed = nodes + displacement[0]
        return lambda time: fixed
    spline = CubicSpline(np.arange(len(motion)) / fps, displacement)
    last = (len(motion) - 1) / fps
    return lambda time: nodes + spline(min(max(time, 0.0), last))


@dataclass(frozen=True, eq=False)
class HeldRegion:
    """Held vertices among those of a reference geometry.

    Attributes:
        vertices: of the reference [m], shape [R, 3].
        held: indices of the held ones, shape [H].
        triangles: corners [m] of the reference's triangles, or faces of its tetrahedra, between held vertices,
            shape [F, 3, 3].
        tets: corners [m] of its tetrahedra between held vertices, shape [E, 4, 3].
    """

    vertices: Float[np.ndarray, "R 3"]
    held: Int[np.ndarray, " H"]
    triangles: Float[np.ndarray, "F 3 3"]
    tets: Float[np.ndarray, "E 4 3"]

    @classmethod
    def of(
        cls, vertices: Float[np.ndarray, "R 3"], held: Int[np.ndarray, " H"], cells: Int[np.ndarray, "E k"] | None
    ) -> HeldRegion:
        """From vertices [m], the indices of those that are held, and tetrahedra [E, 4] or triangles [E, 3]."""
        cells = np.zeros((0, 3), np.int64) if cells is None else cells
        faces = cells[:, FACE_CORNERS].reshape(-1, 3) if cells.shape[1] == 4 else cells
        marked = np.isin(np.arange(len(vertices)), held)
        within = cells[marked[cells].all(1)] if cells.shape[1] == 4 else np.zeros((0, 4), np.int64)
        return cls(vertices, held, vertices[faces[marked[faces].all(1)]], vertices[within])

    def holds(self, points: Float[np.ndarray, "P 3"], *, reach: float) -> Bool[np.ndarray, " P"]:
        """Which points are held: nearest to a held vertex, and in the region or at most `reach` [m] away from it.

        If no triangle has three held vertices, these are the points nearest to the held vertices.
        """
        if len(self.held) == 0:
            return np.zeros(len(points), bool)
        if len(self.triangles) == 0:
            marked = np.zeros(len(points), bool)
            marked[cKDTree(points).query(self.vertices[self.held])[1]] = True
            return marked
        near = np.isin(cKDTree(self.vertices).query(points)[1], self.held)
        return near & ((self._distance(points) <= reach) | self._inside(points))

    def _distance(self, points: np.ndarray) -> np.ndarray:
        """Distance to the triangles [m]."""
        count = min(_NEAR, len(self.triangles))
        index = cKDTree(self.triangles.mean(1)).query(points, k=[*range(1, count + 1)])[1]
        feet = closest_points(self.triangles[index], points[:, None])
        return np.linalg.norm(points[:, None] - feet, axis=-1).min(1)

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Whether points are in one of the tetrahedra."""
        inside = np.zeros(len(points), bool)
        for corners in self.tets:
            edges = np.linalg.solve((corners[1:] - corners[0]).T, (points - corners[0]).T)
            inside |= (edges >= 0).all(0) & (edges.sum(0) <= 1)
        return inside
