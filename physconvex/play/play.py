"""From a surface and a configuration to its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from physconvex.contact import Plane
from physconvex.elastic_terms import with_fibres, with_strain_stiffening
from physconvex.fem import ElasticBody, TetMesh, tetrahedralize
from physconvex.inelastic import FlowRule, Plasticine, Sand, StandardLinearSolid
from physconvex.materials import Law, get_law
from physconvex.play.config import FloorConfig, MaterialConfig, PlayConfig
from physconvex.play.surface import RestSurface
from physconvex.reduced import (
    BodySamples,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    ReducedTrajectory,
    WeightField,
    Wind,
    eigenmode_weights,
    simulate,
    train_neural_weights,
)

__all__ = ["PlayedObject", "play"]


@dataclass(frozen=True)
class PlayedObject:
    """A surface in motion.

    Attributes:
        config: what was played.
        surface: the surface where it starts.
        positions: of its vertices at the frames [m], shape [T, V, 3].
        trajectory: of the reduced body.
        mass: of the body [kg].
        volume: of the body [m³].
    """

    config: PlayConfig
    surface: RestSurface
    positions: Float[np.ndarray, "T V 3"]
    trajectory: ReducedTrajectory
    mass: float
    volume: float


def play(
    surface: RestSurface, config: PlayConfig | None = None, *, on_frame: Callable[[int], None] | None = None
) -> PlayedObject:
    """Simulate a surface as a solid reduced body.

    Args:
        surface: closed surface as it comes from a file; `config.object` sizes and places it.
        config: everything else; the defaults drop an elastic body.
        on_frame: called with the number of every finished frame.

    Raises:
        InputError: the surface has no inside, or too many modes for its mesh.
        ConvergenceError: a time step failed.
    """
    config = PlayConfig() if config is None else config
    placed, material = surface.placed(config.object), config.material
    mesh = tetrahedralize(
        (placed.vertices, placed.faces), order=2, method=config.basis.mesher, max_nodes=config.basis.max_nodes
    )
    points, areas = placed.contact_points(config.basis.contact_points)
    # the surface itself touches, not the nodes of the coarse mesh behind it
    samples = replace(BodySamples.of_mesh(mesh), surface_points=points, surface_areas=areas)
    body = ReducedBody(
        ReducedSpace(_field(config, mesh, samples), samples),
        law=_law(material),
        flow=_flow(material),
        youngs_modulus=material.youngs_modulus,
        poisson_ratio=material.poisson_ratio,
        density=material.density,
    )
    run = simulate(_scene(body, config), on_frame=on_frame, **config.time.model_dump())
    positions = run.positions(placed.vertices)
    return PlayedObject(config, placed, positions, run, body.total_mass, body.volume)


def _field(config: PlayConfig, mesh: TetMesh, samples: BodySamples) -> WeightField:
    """Skinning weights; those of a body of one material do not depend on its stiffness."""
    basis = config.basis
    if basis.kind == "eigenmodes":
        return eigenmode_weights(ElasticBody(mesh), basis.modes)
    generator = torch.Generator().manual_seed(basis.seed)
    return train_neural_weights(samples, basis.modes, generator=generator, poisson_ratio=config.material.poisson_ratio)


def _law(material: MaterialConfig) -> Law:
    law = get_law(material.law)
    if material.stiffening > 0:
        law = with_strain_stiffening(law, material.stiffening)
    if material.fibre_ratio > 0:
        assert material.fibre_direction is not None
        law = with_fibres(law, material.fibre_direction, material.fibre_ratio)
    return law


def _flow(material: MaterialConfig) -> FlowRule | None:
    match material.kind:
        case "plasticine":
            assert material.yield_stress is not None
            return Plasticine(material.yield_stress)
        case "sand":
            assert material.friction_angle_deg is not None
            return Sand(float(np.radians(material.friction_angle_deg)))
        case "viscoelastic":
            assert material.modulus_ratio is not None and material.relaxation_time is not None
            return StandardLinearSolid(material.modulus_ratio, material.relaxation_time)
    return None


def _floor(config: FloorConfig) -> Plane:
    velocity, period = np.asarray(config.velocity), config.period
    if period is None:
        return Plane(friction=config.friction, velocity=velocity)
    return Plane(friction=config.friction, velocity=lambda t: velocity * np.sin(2 * np.pi * t / period))


def _scene(body: ReducedBody, config: PlayConfig) -> ReducedScene:
    forces = config.forces
    return ReducedScene(
        body,
        obstacles=() if config.floor is None else (_floor(config.floor),),
        gravity=forces.gravity,
        push=forces.push,
        wind=None if forces.wind is None else Wind(forces.wind, forces.drag_coefficient),
        damping_time=config.material.damping_time,
        initial_velocity=config.object.velocity,
        initial_angular_velocity=config.object.angular_velocity,
    )
