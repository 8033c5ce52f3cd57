"""Places of forces on a body: its whole surface, the contacts of a motion, or the pins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.dynamics import Obstacle, Pins
from physconvex.errors import InputError
from physconvex.mesh import TetMesh


def surface_patches(points: Float[np.ndarray, "S 3"], count: int) -> Int[np.ndarray, " S"]:
    """Number of the patch of each surface point, 0 to `count` − 1.

    Centres by farthest-point sampling, starting with the point farthest from the middle.
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
    """Loads on single nodes of the surface, those nearest to obstacles in a motion, in decreasing order of contact.

    The size of each is its node's area times its closeness, summed over the frames. A rough motion is enough, for
    example that of twenty eigenmodes: `run.positions(mesh.vertices)`. Its k-th frame with contact counts 1/k: the first
    contact determines the rest, and a rough motion loses accuracy with time.

    Args:
        mesh: of the body.
        positions: of its nodes at the frames [m].
        times: of the frames [s].
        obstacles: planes and spheres.
        count: most nodes.
        margin: distance that counts as contact, over the size of the body.

    Returns:
        one column for each node, the first of size one; fewer than `count` if fewer are touched, none without contact.
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
