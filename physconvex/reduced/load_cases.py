"""Where forces act on a body: all over its surface, where a motion touches something, or where it is held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.dynamics import Obstacle, Pins
from physconvex.errors import InputError
from physconvex.mesh import TetMesh


def surface_patches(points: Float[np.ndarray, "S 3"], count: int) -> Int[np.ndarray, " S"]:
    """Number of the patch that each surface point belongs to, 0 to `count` − 1.

    Centres by farthest-point sampling, the first one the point that is farthest from the middle.
    """
    distance = np.linalg.norm(points - points.mean(0), axis=1)
    owner, nearest = np.zeros(len(points), dtype=np.int64), np.full(len(points), np.inf)
    for number in range(count):
        centre = points[int(distance.argmax())]
        distance = np.minimum(np.linalg.norm(points - centre, axis=1), nearest)
        owner[distance < nearest] = number
        nearest = distance
    return owner


def even_loads(mesh: TetMesh, patches: int) -> Float[np.ndarray, "V K"]:
    """Even loads of the same size on patches that cover the surface, one column each.

    Raises:
        InputError: no patch, or more than the surface has nodes.
    """
    boundary = np.flatnonzero(mesh.node_areas > 0)
    if not 1 <= patches <= len(boundary):
        raise InputError(f"patches: got {patches}; expected 1 to {len(boundary)}, the number of nodes on the surface")
    loads = np.zeros((len(mesh.vertices), patches))
    loads[boundary, surface_patches(mesh.vertices[boundary], patches)] = mesh.node_areas[boundary]
    return loads / loads.sum(0)


def touched_loads(
    mesh: TetMesh,
    positions: Float[np.ndarray, "T V 3"],
    times: Float[np.ndarray, " T"],
    obstacles: Sequence[Obstacle],
    *,
    count: int = 60,
    margin: float = 0.02,
) -> Float[np.ndarray, "V K"]:
    """Loads on single nodes of the surface, those that a motion brings nearest to obstacles, most touched first.

    Each is as large as its node's area times how near it came, summed over the frames. A rough motion is enough, for
    example that of twenty eigenmodes: `run.positions(mesh.vertices)`. Its k-th frame that touches counts 1/k: what
    touches first decides what happens next, and a rough motion is right the longer the less.

    Args:
        mesh: of the body.
        positions: of its nodes at the frames [m].
        times: of the frames [s].
        obstacles: planes and spheres.
        count: most nodes.
        margin: how near counts as touched, over the size of the body.

    Returns:
        one column for each node, the first of size one; fewer than `count` where fewer are touched, none where nothing
        is.
    """
    if np.shape(positions) != (len(times), *mesh.vertices.shape):
        raise InputError(f"positions: got shape {np.shape(positions)}; expected {(len(times), *mesh.vertices.shape)}")
    reach, touched = margin * mesh.size, np.zeros(len(mesh.vertices))
    touching = 0  # frames so far
    for time, nodes in zip(times, positions, strict=True):
        near = sum(np.clip(reach - obstacle.gap(nodes, float(time)), 0, None) for obstacle in obstacles)
        if np.any(near > 0):
            touching += 1
            touched += near / touching
    touched *= mesh.node_areas
    nodes = np.argsort(-touched, kind="stable")[:count]
    nodes = nodes[touched[nodes] > 0]
    loads = np.zeros((len(touched), len(nodes)))
    loads[nodes, np.arange(len(nodes))] = touched[nodes] / touched.max(initial=0.0)
    return loads


def held_nodes(mesh: TetMesh, pins: Pins) -> Bool[np.ndarray, " V"]:
    """Nodes next to pins."""
    held = np.zeros(len(mesh.vertices), dtype=bool)
    held[cKDTree(mesh.vertices).query(pins.points)[1]] = True
    return held
