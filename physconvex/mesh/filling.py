"""The part of each element that the body fills: coarse elements cut corners and fill hollows, integrals need not.

Mass and energy are integrals over the interior of a surface, independent of the tetrahedra that carry the motion: the
finite cell method (Parvizian, Düster & Rank 2007), for meshes that approximately follow the surface. Points spread over
the interior are assigned to the elements that contain them, those outside the mesh to the nearest. Four points of equal
weight per element reproduce the volume, the centre and the second moments of its part (Gauss' rule of degree 2 if it is
full). The mass is summed over all points. An element counts as filled by at least a twentieth, so that it never becomes
soft. An element with fewer points than nodes gets the volume of one more point, spread evenly: otherwise some of its
motions have no resistance.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import qmc

from physconvex.mesh.elements import QUADRATURE, unit_mass
from physconvex.mesh.embedding import continued_shape_values, locate
from physconvex.mesh.surfaces import enclosed_volume, surface_distance
from physconvex.mesh.tet_mesh import Filling, TetMesh

_POINTS, _PER_ELEMENT = 20_000, 60  # inside the surface, at least
_BLOCK, _BLOCKS = 10_000, 60  # drawn at once in the surface's box, and most blocks: few points are inside thin sheets
_LEAST = 0.05  # least filled share of an element
# corners of a regular tetrahedron: in its coordinates Gauss' rule of degree 2 spreads alike in all directions
_REGULAR = np.array(
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, np.sqrt(3) / 2, 0.0], [0.5, np.sqrt(3) / 6, np.sqrt(2 / 3)]]
)
_TO_BARYCENTRIC = np.linalg.inv(np.vstack([_REGULAR.T, np.ones(4)]))
_RULE = QUADRATURE[2][0] @ _REGULAR
_CENTRE = _RULE.mean(axis=0)
_SPREAD = float(np.square(_RULE - _CENTRE).sum() / 12)  # variance of one coordinate, of rule and tetrahedron alike


def filled(mesh: TetMesh, vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> TetMesh:
    """The same mesh, filled as far as a closed surface fills its elements; unchanged if the surface is open or flat.

    Args:
        mesh: approximately follows the surface, linear or quadratic.
        vertices: of the surface [m].
        triangles: outward oriented.
    """
    vertices, triangles = np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(triangles)
    volume = enclosed_volume(vertices, triangles)
    if volume is None:
        return mesh
    count = max(_POINTS, _PER_ELEMENT * len(mesh.tets))
    points = _inside(vertices.tobytes(), triangles.astype(np.int64).tobytes(), count)
    return replace(mesh, filling=_filling(mesh, points, volume / len(points))) if len(points) else mesh


@lru_cache(maxsize=2)
def _inside(vertices: bytes, triangles: bytes, count: int) -> Float[np.ndarray, "S 3"]:
    """About `count` points spread evenly over the interior of a closed surface, deterministic (Halton)."""
    corners, faces = np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(triangles, dtype=np.int64).reshape(-1, 3)
    low, high = corners[np.unique(faces)].min(axis=0), corners[np.unique(faces)].max(axis=0)
    distance, sequence = surface_distance(corners, faces), qmc.Halton(3, scramble=False)
    found = np.zeros((0, 3))
    for _ in range(_BLOCKS):
        points = low + (high - low) * sequence.random(_BLOCK)
        found = np.concatenate([found, points[distance(points) < 0]])
        if len(found) >= count:
            break
    return found


def _filling(mesh: TetMesh, points: Float[np.ndarray, "S 3"], share: float) -> Filling:
    """The filled part of each element, from such points, each of which represents the same volume [m³]."""
    cells, barycentric, anchors, distance = locate(mesh, points)
    counts = np.bincount(cells, minlength=len(mesh.tets))
    volumes = share * counts
    weight = np.maximum(volumes, _LEAST * mesh.element_volumes)
    each = share * np.where(counts < mesh.tets.shape[1], counts / (counts + 1), 1.0)
    even = weight - each * counts
    rule = _rules(cells, anchors @ _REGULAR, each / weight, even / weight)
    shapes = continued_shape_values(barycentric, anchors, distance > 0, mesh.order)
    mass = _mass_blocks(cells, shapes, each) + even[:, None, None] * unit_mass(mesh.order)
    return Filling(rule, weight[:, None] * QUADRATURE[2][1], mass, points, cells, share)


def _rules(
    cells: Int[np.ndarray, " S"],
    places: Float[np.ndarray, "S 3"],
    share: Float[np.ndarray, " E"],
    even: Float[np.ndarray, " E"],
) -> Float[np.ndarray, "E 4 4"]:
    """Four barycentric points of each element, with the centre and the second moments of its filled part.

    Args:
        cells: elements of the points in the body.
        places: of these points in the regular tetrahedron.
        share: share of each element's filled part that one point represents.
        even: share of each element's filled part that is spread evenly.
    """
    count = len(even)
    centred = places - _CENTRE
    products = (centred[:, :, None] * centred[:, None, :]).reshape(-1, 9).T
    mean = share[:, None] * np.stack([np.bincount(cells, c, count) for c in centred.T], axis=1)
    second = share[:, None] * np.stack([np.bincount(cells, p, count) for p in products], axis=1)
    second = second.reshape(-1, 3, 3) + even[:, None, None] * _SPREAD * np.eye(3)
    spread = second - mean[:, :, None] * mean[:, None, :]
    values, axes = np.linalg.eigh(spread)
    root = np.einsum("eij,ej,ekj->eik", axes, np.sqrt(np.maximum(values, 0.0) / _SPREAD), axes)
    placed = _CENTRE + mean[:, None] + np.einsum("eij,qj->eqi", root, _RULE - _CENTRE)
    return np.concatenate([placed, np.ones((count, 4, 1))], axis=-1) @ _TO_BARYCENTRIC.T


def _mass_blocks(
    cells: Int[np.ndarray, " S"], shapes: Float[np.ndarray, "S n"], each: Float[np.ndarray, " E"]
) -> Float[np.ndarray, "E n n"]:
    """∫ N_a N_b dV of each element [m³]: the sum over its points."""
    count = len(each)
    blocks = np.zeros((count, shapes.shape[1], shapes.shape[1]))
    order = np.argsort(cells, kind="stable")
    ends = np.searchsorted(cells[order], np.arange(count + 1))
    for element in range(count):
        inner = shapes[order[ends[element] : ends[element + 1]]]
        blocks[element] = each[element] * inner.T @ inner
    return blocks
