"""A scene with a body whose weights suit its contacts and pins, and the places of the forces that this takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.dynamics import Obstacle, Pins, Timing, simulate
from physconvex.errors import InputError
from physconvex.fem import ElasticBody
from physconvex.mesh import TetMesh
from physconvex.reduced.basis import NodalWeights
from physconvex.reduced.elastic_basis import elastic_weights
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.space import ReducedSpace

_PATCHES = 20


def with_elastic_weights(
    scene: ReducedScene,
    mesh: TetMesh,
    count: int,
    timing: Timing | None = None,
    *,
    passes: int = 2,
    loaded: int = 60,
) -> ReducedScene:
    """The scene with weights from its body's vibration modes and its responses to forces at its contacts.

    A roll-out of the given scene finds the contacts. A second roll-out with the weights found refines them, since a
    body that lands differently touches elsewhere. See `weights_for_motion`; the scene's pins are held.

    Args:
        scene: with a rough body, for example of twenty eigenmodes.
        mesh: tetrahedra that sample the body (`BodySamples.of_mesh`).
        count: M, number of weights.
        timing: of the roll-outs.
        passes: number of roll-outs.
        loaded: most loaded nodes.

    Raises:
        InputError: the body is not sampled by the mesh's tetrahedra, starts from coordinates of its weights, or as
        `elastic_weights`.
        ConvergenceError: a roll-out failed.
    """
    body = scene.body
    if len(body.youngs_modulus) != len(mesh.tets):
        raise InputError(
            f"mesh: got {len(mesh.tets)} tetrahedra for a body of {len(body.youngs_modulus)} cells; expected the mesh "
            "that the body is sampled by"
        )
    if scene.initial_coordinates is not None:
        raise InputError("scene: starts from coordinates, which belong to its weights; expected a start at rest")
    elastic = ElasticBody(
        mesh,
        law=body.law,
        youngs_modulus=body.youngs_modulus,
        poisson_ratio=body.poisson_ratio,
        density=body.density,
    )
    held = None if scene.pins is None else held_nodes(mesh, scene.pins)
    for _ in range(passes):
        run = simulate(scene, timing)
        positions = run.positions(mesh.vertices)
        weights = weights_for_motion(elastic, count, positions, run.times, scene.obstacles, clamped=held, loaded=loaded)
        scene = replace(scene, body=body.with_space(ReducedSpace(weights, body.space.samples, interpolated=True)))
        if held is None and not scene.obstacles:  # nothing to land on: another roll-out finds the same
            break
    return scene


def weights_for_motion(
    body: ElasticBody,
    count: int,
    positions: Float[np.ndarray, "T V 3"],
    times: Float[np.ndarray, " T"],
    obstacles: Sequence[Obstacle],
    *,
    clamped: Bool[np.ndarray, " V"] | None = None,
    loaded: int = 60,
    spanned: bool = False,
) -> NodalWeights:
    """Weights from vibrations, and from responses to forces where a motion touches obstacles (`elastic_weights`).

    The responses are those at rest and about the most deformed frames (`most_deformed`). A free body that touches
    nothing is loaded all over its surface, at rest.

    Args:
        body: the body.
        count: M, number of weights.
        positions: of its nodes at the frames [m].
        times: of the frames [s].
        obstacles: planes and spheres.
        clamped: nodes that are held.
        loaded: most loaded nodes.
        spanned: whether the weights have to represent the motion itself too: then it should be that of a full model.

    Raises:
        InputError: as `elastic_weights` and `touched_loads`.
    """
    loads = touched_loads(body.mesh, positions, times, obstacles, count=loaded)
    if clamped is not None:
        loads = loads[:, ~loads[clamped].any(0)]  # forces on held nodes have no effect
    motion = positions if spanned else None
    if clamped is None and not loads.size:
        return elastic_weights(body, count, even_loads(body.mesh, _PATCHES), motion=motion)
    return elastic_weights(body, count, loads, clamped=clamped, states=most_deformed(body, positions), motion=motion)


def most_deformed(body: ElasticBody, positions: Float[np.ndarray, "T V 3"]) -> Float[np.ndarray, "S V 3"]:
    """Frames with the most deformation: the one of largest elastic energy, and the one that reaches half of it.

    Args:
        body: the body.
        positions: of its nodes at the frames [m].

    Returns:
        two frames, or one if the energy rises at once.
    """
    energies = np.array([body.energy(x) for x in positions])
    energies[~np.isfinite(energies)] = -np.inf  # a rough roll-out may turn elements inside out
    most = int(energies.argmax())
    half = most
    while half > 0 and energies[half - 1] > energies[most] / 2:
        half -= 1
    return positions[sorted({half, most})]


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
