"""From surfaces and configurations to their motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int

from physconvex.contact import Plane
from physconvex.convex import ConvexField, advect, affine_map, union_volume
from physconvex.elastic_terms import with_fibres, with_strain_stiffening
from physconvex.fem import ElasticBody, TetMesh, tetrahedralize
from physconvex.fem.mesh_volume import enclosed_volume, with_volume
from physconvex.inelastic import FlowRule, Plasticine, Sand, StandardLinearSolid
from physconvex.materials import Law, get_law
from physconvex.play.assets import Asset
from physconvex.play.config import FloorConfig, MaterialConfig, PlayConfig
from physconvex.play.surface import RestSurface
from physconvex.reduced import (
    BodySamples,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    ReducedTrajectory,
    ReducedWorld,
    Shell,
    WeightField,
    Wind,
    contact_weights,
    eigenmode_weights,
    simulate,
    simulate_world,
    train_neural_weights,
)

__all__ = ["PlayedObject", "play", "play_together"]


@dataclass(frozen=True)
class PlayedObject:
    """One or several surfaces in motion.

    Attributes:
        config: what was played; that of the first object where there are several.
        surface: the surfaces where they start, one after the other.
        positions: of their vertices at the frames [m], shape [T, V, 3].
        trajectories: of the reduced bodies.
        owners: number of the object that each vertex belongs to, shape [V].
        masses: of the bodies [kg].
        volumes: of the bodies [m³].
        convexes: the convex field of each object that has one, where it starts.
    """

    config: PlayConfig
    surface: RestSurface
    positions: Float[np.ndarray, "T V 3"]
    trajectories: tuple[ReducedTrajectory, ...]
    owners: Int[np.ndarray, " V"]
    masses: tuple[float, ...]
    volumes: tuple[float, ...]
    convexes: tuple[ConvexField | None, ...]

    @property
    def trajectory(self) -> ReducedTrajectory:
        """That of the first body."""
        return self.trajectories[0]

    @property
    def mass(self) -> float:
        """Of all bodies [kg]."""
        return sum(self.masses)

    @property
    def volume(self) -> float:
        """Of all bodies [m³]."""
        return sum(self.volumes)


@dataclass(frozen=True)
class _Prepared:
    """An object where it starts, and its scene."""

    surface: RestSurface
    convexes: ConvexField | None
    scene: ReducedScene


def play(
    surface: RestSurface | Asset,
    config: PlayConfig | None = None,
    *,
    on_frame: Callable[[int], None] | None = None,
) -> PlayedObject:
    """Simulate a surface, or a convex field, as a solid reduced body.

    Args:
        surface: closed surface as it comes from a file, or any asset; `config.object` sizes and places it.
        config: everything else; the defaults drop an elastic body.
        on_frame: called with the number of every finished frame.

    Raises:
        InputError: the surface has no inside, or too many modes for its mesh.
        ConvergenceError: a time step failed.
    """
    return play_together([surface], [PlayConfig() if config is None else config], on_frame=on_frame)


def play_together(
    assets: Sequence[RestSurface | Asset],
    configs: Sequence[PlayConfig],
    *,
    on_frame: Callable[[int], None] | None = None,
) -> PlayedObject:
    """Simulate several objects in one scene; each falls from its `drop_height` over the one before it.

    Args:
        assets: surfaces, or assets.
        configs: one per asset; floor, forces, friction between objects and time are those of the first.
        on_frame: called with the number of every finished frame.

    Raises:
        InputError, ConvergenceError: as `play`.
    """
    first, ground, prepared = configs[0], 0.0, []
    for asset, config in zip(assets, configs, strict=True):
        shared = config.model_copy(update={"floor": first.floor, "forces": first.forces})
        prepared.append(_prepare(Asset(asset) if isinstance(asset, RestSurface) else asset, shared, ground))
        ground = float(prepared[-1].surface.vertices[:, 2].max())
    options = first.time.model_dump()
    scenes = tuple(one.scene for one in prepared)
    if len(prepared) == 1:
        runs: tuple[ReducedTrajectory, ...] = (simulate(scenes[0], on_frame=on_frame, **options),)
    else:
        world = ReducedWorld(scenes, friction=first.contact.friction)
        runs = simulate_world(world, on_frame=on_frame, **options).bodies
    counts = [len(one.surface.vertices) for one in prepared]
    starts = np.cumsum([0, *counts[:-1]])
    return PlayedObject(
        first,
        RestSurface(
            np.concatenate([one.surface.vertices for one in prepared]),
            np.concatenate([one.surface.faces + start for one, start in zip(prepared, starts, strict=True)]),
        ),
        np.concatenate([run.positions(one.surface.vertices) for run, one in zip(runs, prepared, strict=True)], axis=1),
        runs,
        np.repeat(np.arange(len(counts)), counts),
        tuple(one.scene.body.total_mass for one in prepared),
        tuple(one.scene.body.volume for one in prepared),
        tuple(one.convexes for one in prepared),
    )


def _prepare(asset: Asset, config: PlayConfig, ground: float) -> _Prepared:
    """Place an object and make its body."""
    linear, shift = asset.surface.placement(config.object, ground=ground)
    placed, material = asset.surface.moved(linear, shift), config.material
    convexes = asset.convexes
    if convexes is not None:
        kind = convexes.points
        convexes = advect(convexes, affine_map(torch.as_tensor(linear).to(kind), torch.as_tensor(shift).to(kind)))
    mesh = tetrahedralize(
        (placed.vertices, placed.faces),
        order=2,
        method="ftetwild" if convexes is not None and config.basis.mesher == "auto" else config.basis.mesher,
        max_nodes=config.basis.max_nodes,
        match_volume=convexes is None,  # hulls overlap: their volumes do not add up
    )
    mesh = mesh if convexes is None else with_volume(mesh, union_volume(convexes))
    samples = BodySamples.of_mesh(mesh)
    if convexes is None:  # the surface itself touches, not the nodes of the coarse mesh behind it
        points, areas = placed.contact_points(config.basis.contact_points)
        closed = enclosed_volume(placed.vertices, placed.faces) is not None
        shell = Shell(placed.vertices, placed.faces) if closed else samples.shell
        samples = replace(samples, surface_points=points, surface_areas=areas, shell=shell)
    body = ReducedBody(
        ReducedSpace(_field(config, mesh, samples), samples, interpolated=config.basis.kind == "contact"),
        law=_law(material),
        flow=_flow(material),
        youngs_modulus=material.youngs_modulus,
        poisson_ratio=material.poisson_ratio,
        density=material.density,
    )
    return _Prepared(placed, convexes, _scene(body, config))


def _field(config: PlayConfig, mesh: TetMesh, samples: BodySamples) -> WeightField:
    """Skinning weights; those of a body of one material depend on its fibres, not on its stiffness."""
    basis, body = config.basis, ElasticBody(mesh, law=_law(config.material))
    if basis.kind == "eigenmodes":
        return eigenmode_weights(body, basis.modes)
    if basis.kind == "contact":
        smooth = basis.modes // 3
        return contact_weights(body, basis.modes - smooth, eigenmodes=smooth)
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
