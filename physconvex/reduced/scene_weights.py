"""A scene with a body whose weights suit its contacts and pins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Timing, simulate
from physconvex.errors import InputError
from physconvex.fem import ElasticBody
from physconvex.mesh import TetMesh
from physconvex.reduced.elastic_basis import elastic_weights
from physconvex.reduced.load_cases import even_loads, held_nodes, touched_loads
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
    body that lands differently touches elsewhere. The responses are those about the rest state, about the frame of that
    roll-out with the largest deformation, and about the one half-way to it, with the scene's pins held. Without
    contacts and pins, patches all over the surface are loaded, at rest.

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
        loads = touched_loads(mesh, positions, run.times, scene.obstacles, count=loaded)
        if held is not None:
            loads = loads[:, ~loads[held].any(0)]  # forces on held nodes have no effect
        alone = held is None and not loads.size
        if alone:
            weights = elastic_weights(elastic, count, even_loads(mesh, _PATCHES))
        else:
            weights = elastic_weights(elastic, count, loads, clamped=held, states=most_deformed(elastic, positions))
        space = ReducedSpace(weights, body.space.samples, interpolated=True)
        scene = replace(scene, body=body.with_space(space))
        if alone:
            break
    return scene


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
