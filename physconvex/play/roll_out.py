"""From surfaces and configurations to their motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int

from physconvex.convex import (
    AdaptedField,
    ConvexField,
    adapt_to_motion,
    advect,
    affine_map,
    bent_frames,
    space_map,
    union_volume,
)
from physconvex.dynamics import Plane, State, Timing, Wind, simulate
from physconvex.fem import ElasticBody
from physconvex.materials import (
    FlowRule,
    Law,
    Plasticine,
    Sand,
    StandardLinearSolid,
    get_law,
    with_fibres,
    with_strain_stiffening,
)
from physconvex.mesh import TetMesh, enclosed_volume, tetrahedralize, with_volume
from physconvex.play.assets import Asset, RestSurface
from physconvex.play.config import BodyMaterialConfig, FloorConfig, PlayConfig
from physconvex.play.union_surface import surface_of_union
from physconvex.reduced import (
    BodySamples,
    ReducedBodies,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    ReducedTrajectory,
    Shell,
    SkinningField,
    WeightField,
    eigenmode_weights,
    elastic_weights,
    even_loads,
    predicted_weights,
    train_neural_weights,
    with_elastic_weights,
)


@dataclass(frozen=True)
class PlayedObject:
    """One or several surfaces in motion.

    Attributes:
        config: the configuration; that of the first object if there are several.
        surface: the surfaces at the start, one after the other.
        positions: of their vertices at the frames [m], shape [T, V, 3].
        trajectories: of the reduced bodies.
        owners: number of the object that each vertex belongs to, shape [V].
        masses: of the bodies [kg].
        volumes: of the bodies [m³].
        adapted: the convex field of each object that has one, at the start, split where the motion bends its convexes.
    """

    config: PlayConfig
    surface: RestSurface
    positions: Float[np.ndarray, "T V 3"]
    trajectories: tuple[ReducedTrajectory, ...]
    owners: Int[np.ndarray, " V"]
    masses: tuple[float, ...]
    volumes: tuple[float, ...]
    adapted: tuple[AdaptedField | None, ...]

    def _repr_html_(self) -> str:
        """Numbers and pictures, for a notebook."""
        from physconvex.play.pictures import played_html  # loads matplotlib

        return played_html(self)

    @property
    def trajectory(self) -> ReducedTrajectory:
        """That of the first body."""
        return self.trajectories[0]

    def viewpoint(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"], float]:
        """Eye [m] a little above the floor, middle [m] and half extent [m] of the motion, for pictures of it."""
        low, high = self.positions.min((0, 1)), self.positions.max((0, 1))
        middle, reach = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        return middle + 3.6 * reach * np.array([0.35, -0.9, 0.32]), middle, reach

    @property
    def convexes(self) -> tuple[ConvexField | None, ...]:
        """The convex field of each object that has one, at the start."""
        return tuple(None if one is None else one.field for one in self.adapted)

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
    surface: RestSurface | Asset, config: PlayConfig | None = None, *, on_frame: Callable[[State], None] | None = None
) -> PlayedObject:
    """Simulate a surface, or a convex field, as a solid reduced body.

    Args:
        surface: closed surface as in a file, or any asset; `config.object` sizes and places it.
        config: everything else; the defaults drop an elastic body.
        on_frame: called with the state at every finished frame.

    Raises:
        InputError: the surface has no inside, or too many modes for its mesh.
        ConvergenceError: a time step failed.
    """
    return play_together([surface], [PlayConfig() if config is None else config], on_frame=on_frame)


def play_together(
    assets: Sequence[RestSurface | Asset],
    configs: Sequence[PlayConfig],
    *,
    on_frame: Callable[[State], None] | None = None,
) -> PlayedObject:
    """Simulate several objects in one scene; each falls from its `drop_height` over the one before it.

    Args:
        assets: surfaces, or assets.
        configs: one per asset; floor, forces, friction between objects and time are those of the first.
        on_frame: called with the state at every finished frame.

    Raises:
        InputError, ConvergenceError: as `play`.
    """
    first, ground, prepared = configs[0], 0.0, []
    for asset, config in zip(assets, configs, strict=True):
        shared = config.model_copy(update={"floor": first.floor, "forces": first.forces})
        asset = Asset(asset) if isinstance(asset, RestSurface) else asset
        prepared.append(_prepare(asset, shared, ground, alone=len(assets) == 1))
        ground = float(prepared[-1].surface.vertices[:, 2].max())
    timing = Timing(**first.time.model_dump())
    scenes = tuple(one.scene for one in prepared)
    if len(prepared) == 1:
        runs: tuple[ReducedTrajectory, ...] = (simulate(scenes[0], timing, on_frame=on_frame),)
    else:
        bodies = ReducedBodies(scenes, friction=first.contact.friction)
        runs = simulate(bodies, timing, on_frame=on_frame).bodies
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
        tuple(_adapted(one, run, c) for one, run, c in zip(prepared, runs, configs, strict=True)),
    )


def _adapted(one: _Prepared, run: ReducedTrajectory, config: PlayConfig) -> AdaptedField | None:
    """The field of an object, split for the frames in which it is bent most."""
    if one.convexes is None:
        return None
    rest, settings = one.surface.vertices, config.convexes
    distance = settings.deviation * float(np.ptp(rest, axis=0).max())
    frames = bent_frames(rest, run.positions(rest), distance=distance)
    bent = space_map(run.space, run.coordinates[frames])
    return adapt_to_motion(one.convexes, bent, distance=distance, limit=settings.limit)


def _prepare(asset: Asset, config: PlayConfig, ground: float, *, alone: bool) -> _Prepared:
    """Place an object and make its body; `alone`: only the floor can touch it."""
    linear, shift = asset.surface.placement(config.object, ground=ground)
    placed, convexes = asset.surface.moved(linear, shift), asset.convexes
    if convexes is not None:
        kind = convexes.points
        convexes = advect(convexes, affine_map(torch.as_tensor(linear).to(kind), torch.as_tensor(shift).to(kind)))
    skin = surface_of_union(convexes) if asset.overlapping and convexes is not None else placed
    mesh = tetrahedralize(
        (skin.vertices, skin.faces), order=2, method=config.basis.mesher, max_nodes=config.basis.max_nodes
    )
    if skin is not placed and convexes is not None:
        mesh = with_volume(mesh, union_volume(convexes))
    samples = BodySamples.of_mesh(mesh)
    # the surface itself makes contact, not the nodes of the coarse mesh
    points, areas = skin.contact_points(config.basis.contact_points)
    closed = enclosed_volume(skin.vertices, skin.faces) is not None
    shell = Shell(skin.vertices, skin.faces) if closed else samples.shell
    samples = replace(samples, surface_points=points, surface_areas=areas, shell=shell)
    predicted = None if config.basis.file is None else _predicted(config.basis.file, asset.surface, linear, shift)
    weights = predicted or _weights(config, mesh, samples, alone=alone)
    return _Prepared(placed, convexes, _scene(config, mesh, samples, weights, alone=alone))


def _predicted(file: str, surface: RestSurface, linear: np.ndarray, shift: np.ndarray) -> WeightField:
    """A network's weights on the placed body, x = linear X + shift of the surface as in its file."""
    field, low, high = SkinningField.load(file), surface.vertices.min(0), surface.vertices.max(0)
    stretch = np.cbrt(np.linalg.det(linear))
    return predicted_weights(
        field,
        origin=linear @ (0.5 * (low + high)) + shift,
        rotation=linear / stretch,
        scale=stretch * float((high - low).max()) / field.object_size,
    )


def _scene(
    config: PlayConfig, mesh: TetMesh, samples: BodySamples, weights: WeightField, *, alone: bool
) -> ReducedScene:
    """The body with its skinning weights, and its scene."""
    basis, material, forces = config.basis, config.material, config.forces
    body = ReducedBody(
        ReducedSpace(weights, samples, interpolated=basis.kind == "elastic" and not alone),
        law=_law(material),
        flow=_flow(material),
        youngs_modulus=material.youngs_modulus,
        poisson_ratio=material.poisson_ratio,
        density=material.density,
    )
    scene = ReducedScene(
        body,
        obstacles=() if config.floor is None else (_floor(config.floor),),
        gravity=forces.gravity,
        push=forces.push,
        wind=None if forces.wind is None else Wind(forces.wind, forces.drag_coefficient),
        damping_time=material.damping_time,
        initial_velocity=config.object.velocity,
        initial_angular_velocity=config.object.angular_velocity,
    )
    if basis.kind == "elastic" and alone:
        return with_elastic_weights(scene, mesh, basis.modes, Timing(**config.time.model_dump()))
    return scene


def _weights(config: PlayConfig, mesh: TetMesh, samples: BodySamples, *, alone: bool) -> WeightField:
    """Skinning weights; if elastic ones are still to be found, the rough ones for their start."""
    basis, material = config.basis, config.material
    body = ElasticBody(mesh, law=_law(material), poisson_ratio=material.poisson_ratio)
    if basis.kind == "neural":
        generator = torch.Generator().manual_seed(basis.seed)
        return train_neural_weights(samples, basis.modes, generator=generator, poisson_ratio=material.poisson_ratio)
    if basis.kind == "eigenmodes":
        return eigenmode_weights(body, basis.modes)
    if alone:
        return eigenmode_weights(body, min(20, len(mesh.vertices) - 2))
    return elastic_weights(body, basis.modes, even_loads(mesh, 20))  # another object may touch it anywhere


def _law(material: BodyMaterialConfig) -> Law:
    law = get_law(material.law)
    if material.stiffening > 0:
        law = with_strain_stiffening(law, material.stiffening)
    if material.fibre_ratio > 0:
        assert material.fibre_direction is not None
        law = with_fibres(law, material.fibre_direction, material.fibre_ratio)
    return law


def _flow(material: BodyMaterialConfig) -> FlowRule | None:
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
