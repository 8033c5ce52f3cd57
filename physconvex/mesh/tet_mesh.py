"""Tetrahedral meshes, linear (4 nodes) or quadratic (10 nodes)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import InputError

# Corners joined by mid-edge nodes 4..9 of a quadratic tetrahedron.
EDGE_CORNERS = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
# Faces with outward normals (corners), and the mid-edge nodes opposite to none: (01, 12, 20) of each face.
FACE_CORNERS = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
FACE_MIDDLES = np.array([[6, 5, 4], [4, 8, 7], [5, 9, 8], [7, 9, 6]])


@dataclass(frozen=True, eq=False)
class Filling:
    """The part of each element that the body fills, see `physconvex.fem.filled`.

    Attributes:
        barycentric: points of each element at which the law is evaluated, shape [E, 4, 4].
        weights: volume that each of these points represents [m³], shape [E, 4].
        mass: ∫ N_a N_b dV over each element's part of the body [m³], shape [E, n, n].
        points: evenly spread over the body [m], shape [S, 3].
        cells: the element that carries each, shape [S].
        share: volume that each of them represents [m³].
    """

    barycentric: Float[np.ndarray, "E 4 4"]
    weights: Float[np.ndarray, "E 4"]
    mass: Float[np.ndarray, "E n n"]
    points: Float[np.ndarray, "S 3"]
    cells: Int[np.ndarray, " S"]
    share: float


@dataclass(frozen=True, eq=False)
class TetMesh:
    """A tetrahedral mesh.

    Attributes:
        vertices: node positions [m], shape [V, 3], float64.
        tets: node indices, shape [E, 4] (linear) or [E, 10] (quadratic: corners, then the mid-edge nodes of
            edges 01, 12, 02, 03, 13, 23). Orientation positive: det[x1-x0, x2-x0, x3-x0] > 0.
        mass_shares: share of the body's mass that each node carries as a particle, shape [V]; None: consistent mass
            matrix.
        filling: the part of the elements that the body fills; None: all.

    Raises:
        InputError: wrong shapes, indices out of range, unused vertices, an element without positive volume, shares
            that are not positive or do not add up to one, or a filling of another mesh.
    """

    vertices: Float[np.ndarray, "V 3"]
    tets: Int[np.ndarray, "E n"]
    mass_shares: Float[np.ndarray, " V"] | None = None
    filling: Filling | None = None

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        tets = np.ascontiguousarray(self.tets, dtype=np.int64)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "tets", tets)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise InputError(f"vertices: got shape {vertices.shape}; expected finite [V, 3] in metres")
        if tets.ndim != 2 or tets.shape[1] not in (4, 10) or len(tets) == 0:
            raise InputError(f"tets: got shape {tets.shape}; expected [E, 4] or [E, 10] with E > 0")
        if tets.min() < 0 or tets.max() >= len(vertices):
            raise InputError(f"tets: indices {tets.min()}..{tets.max()}; expected 0..{len(vertices) - 1}")
        if len(np.unique(tets)) != len(vertices):
            raise InputError("vertices: some belong to no tetrahedron; drop them with `compact` before")
        bad = np.flatnonzero(self.element_volumes <= 0)
        if len(bad):
            raise InputError(
                f"tets: {len(bad)} of {len(tets)} have no positive volume (first: {bad[0]}); "
                "swap two of their corners, or mesh again"
            )
        shares = self.mass_shares
        if shares is not None and not (
            shares.shape == (len(vertices),) and (shares > 0).all() and abs(shares.sum() - 1) < 1e-9
        ):
            raise InputError(
                f"mass_shares: got shape {shares.shape} with the sum {shares.sum():.6g}; expected [{len(vertices)}] "
                "positive numbers that add up to 1"
            )
        if self.filling is not None and self.filling.mass.shape != (len(tets), tets.shape[1], tets.shape[1]):
            raise InputError(
                f"filling: got one of {len(self.filling.mass)} elements of {self.filling.mass.shape[-1]} nodes; "
                f"expected {len(tets)} of {tets.shape[1]}: fill the mesh that it is of (`filled`)"
            )

    def with_equal_masses(self) -> TetMesh:
        """The same mesh with a particle of the same mass at every node, as in MuJoCo's flex."""
        return replace(self, mass_shares=np.full(len(self.vertices), 1 / len(self.vertices)))

    @property
    def order(self) -> int:
        """Polynomial degree of the elements: 1 or 2."""
        return 1 if self.tets.shape[1] == 4 else 2

    @property
    def corner_tets(self) -> Int[np.ndarray, "E 4"]:
        """The corner nodes of each element."""
        return self.tets[:, :4]

    @cached_property
    def element_volumes(self) -> Float[np.ndarray, " E"]:
        """Volume of each (straight-edged) element [m³]."""
        return signed_volumes(self.vertices, self.tets)

    @property
    def volume(self) -> float:
        """Volume of the body [m³]."""
        return float(self.element_volumes.sum())

    @property
    def size(self) -> float:
        """Largest edge of the bounding box [m]."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def boundary_faces(self) -> Int[np.ndarray, "F n"]:
        """Outward boundary faces: [F, 3] corners; quadratic meshes [F, 6] with the nodes of edges 01, 12, 20."""
        columns = FACE_CORNERS if self.order == 1 else np.hstack([FACE_CORNERS, FACE_MIDDLES])
        return self.tets[:, columns].reshape(-1, columns.shape[1])[np.sort(self.boundary_rows)]

    @cached_property
    def boundary_rows(self) -> Int[np.ndarray, " F"]:
        """Numbers of the boundary faces among the four of each element, ordered by the faces' corners."""
        faces = np.sort(self.corner_tets[:, FACE_CORNERS].reshape(-1, 3), axis=1)
        _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
        return first[count == 1]

    @cached_property
    def surface(self) -> tuple[Float[np.ndarray, "S 3"], Int[np.ndarray, "F 3"]]:
        """The corners of the boundary [m], and its triangles between them."""
        used, triangles = np.unique(self.boundary_faces[:, :3], return_inverse=True)
        return self.vertices[used], triangles.reshape(-1, 3)

    @cached_property
    def node_areas(self) -> Float[np.ndarray, " V"]:
        """Share of the boundary area carried by each node [m²], zero inside.

        Quadratic faces are lumped over their four linear sub-triangles, which keeps every weight positive.
        """
        faces = self.boundary_faces
        x = self.vertices[faces[:, :3]]
        area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        shares = np.full(3, 1 / 3) if self.order == 1 else np.array([1 / 12] * 3 + [1 / 4] * 3)
        return np.bincount(faces.ravel(), (area[:, None] * shares).ravel(), minlength=len(self.vertices))


def compact(vertices: np.ndarray, tets: np.ndarray) -> TetMesh:
    """Mesh without the vertices that no tetrahedron uses."""
    used, tets = np.unique(tets, return_inverse=True)
    return TetMesh(vertices[used], tets.reshape(-1, tets.shape[-1]))


def mesh_edges(tets: Int[np.ndarray, "E n"]) -> tuple[Int[np.ndarray, "N 2"], Int[np.ndarray, "E 6"]]:
    """The edges between corners, lower number first, and which of them the six of each tetrahedron are."""
    every = np.sort(tets[:, EDGE_CORNERS], axis=2).reshape(-1, 2)
    edges, index = np.unique(every, axis=0, return_inverse=True)
    return edges, index.reshape(-1, 6)


def to_quadratic(mesh: TetMesh) -> TetMesh:
    """The same geometry with quadratic elements, one node in the middle of every edge; a filling is dropped."""
    if mesh.order == 2:
        return mesh
    edges, index = mesh_edges(mesh.tets)
    vertices = np.vstack([mesh.vertices, mesh.vertices[edges].mean(axis=1)])
    return TetMesh(vertices, np.hstack([mesh.tets, len(mesh.vertices) + index]))


def node_count(vertices: np.ndarray, tets: Int[np.ndarray, "E 4"], order: int) -> int:
    """Number of nodes of a linear mesh after conversion to the given order."""
    return len(vertices) if order == 1 else len(vertices) + len(mesh_edges(tets)[0])


def linear_part(mesh: TetMesh) -> TetMesh:
    """The linear mesh on the corner nodes of a quadratic one."""
    return compact(mesh.vertices, mesh.corner_tets)


def box_mesh(
    size: tuple[float, float, float], cells: tuple[int, int, int], *, order: int = 2, mirrored: bool = False
) -> TetMesh:
    """A box with one corner at the origin, split into `cells` hexahedra of six tetrahedra each (Kuhn).

    All diagonals have one direction, so that the mesh bends a little to one side; `mirrored` reverses them in every
    other cell along each edge.
    """
    axes = [np.linspace(0.0, length, n + 1) for length, n in zip(size, cells, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    step = np.array([index[1, 0, 0], index[0, 1, 0], index[0, 0, 1]])
    odd = np.stack(np.meshgrid(*(np.arange(n) % 2 for n in cells), indexing="ij"), axis=-1).reshape(-1, 3) * mirrored
    corner = index[:-1, :-1, :-1].ravel() + odd @ step  # of the first node of each cell
    ways = 1 - 2 * odd
    paths = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [1, 0, 2], [2, 1, 0]])
    walks = np.concatenate([np.cumsum((ways * step)[:, path], axis=1) for path in paths])
    tets = np.tile(corner, len(paths))[:, None] + np.hstack([np.zeros((len(walks), 1), dtype=walks.dtype), walks])
    vertices = grid.reshape(-1, 3)
    mesh = TetMesh(vertices, oriented(vertices, tets))
    return to_quadratic(mesh) if order == 2 else mesh


def signed_volumes(vertices: Float[np.ndarray, "V 3"], tets: Int[np.ndarray, "E n"]) -> Float[np.ndarray, " E"]:
    """Volumes of tetrahedra [m³], negative where the orientation is."""
    x = vertices[tets[:, :4]]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6.0


def oriented(vertices: Float[np.ndarray, "V 3"], tets: Int[np.ndarray, "E 4"]) -> Int[np.ndarray, "E 4"]:
    """The tetrahedra with two corners swapped wherever the orientation is negative."""
    return np.where(signed_volumes(vertices, tets)[:, None] < 0, tets[:, [0, 2, 1, 3]], tets)


def mean_ratios(vertices: Float[np.ndarray, "V 3"], tets: Int[np.ndarray, "E n"]) -> Float[np.ndarray, " E"]:
    """12 (3V)^(2/3) / Σ edge², with the sign of V: 1 if regular, ≤ 0 if inverted (Liu and Joe 1994)."""
    x, volume = vertices[tets[:, :4]], signed_volumes(vertices, tets)
    edges = x[:, EDGE_CORNERS[:, 0]] - x[:, EDGE_CORNERS[:, 1]]
    squares = np.einsum("eka,eka->e", edges, edges)
    return 12.0 * np.sign(volume) * np.cbrt(3.0 * np.abs(volume)) ** 2 / np.maximum(squares, np.finfo(float).tiny)
