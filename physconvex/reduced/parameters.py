"""The parameters that a reduced scene can be differentiated by: reading and setting them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Obstacle, Plane, Wind
from physconvex.errors import InputError
from physconvex.reduced.body import ReducedBody
from physconvex.reduced.scene import ReducedScene

ParameterName = Literal[
    "log10_youngs_modulus",  # log10 of the mean E [Pa]; bodies of several materials are scaled as a whole
    "poisson_ratio",  # mean ν [-]; shifted as a whole
    "density",  # mean ρ [kg/m³]; scaled as a whole
    "gravity_x",
    "gravity_y",
    "gravity_z",  # [m/s²]
    "damping_time",  # [s]
    "air_drag",  # [1/s]
    "contact_damping",  # time of the contact's dashpot [s], which reduces the rebound
    "friction",  # mean coefficient of the obstacles that have one [-]; shifted as a whole
    "floor_height",  # mean distance of the planes from the origin along their normals, at t = 0 [m]; shifted alike
    "wind_x",
    "wind_y",
    "wind_z",  # velocity of the air [m/s]
    "log10_contact_stiffness",  # log10 of kc [Pa/m]; where it is not named, a default kc follows E
    "initial_velocity_x",
    "initial_velocity_y",
    "initial_velocity_z",  # [m/s]
    "initial_angular_velocity_x",
    "initial_angular_velocity_y",
    "initial_angular_velocity_z",  # [rad/s]
    "initial_position_x",
    "initial_position_y",
    "initial_position_z",  # centre of mass [m]
    "initial_orientation_x",
    "initial_orientation_y",
    "initial_orientation_z",  # rotation vector about the centre of mass [rad]
]
PARAMETERS: tuple[str, ...] = get_args(ParameterName)
REGIONAL = ("log10_youngs_modulus", "poisson_ratio", "density")  # also per region of the body, as `density[0]`
FLOW_PARAMETERS = ("yield_stress", "friction_angle", "modulus_ratio", "relaxation_time")  # of a flow rule that has them
_AXES = {"x": 0, "y": 1, "z": 2}


def check_parameters(scene: ReducedScene, names: Sequence[str]) -> None:
    """Check that names are known, different, and present in the scene.

    Raises:
        InputError: they are not.
    """
    unknown = [name for name in names if not _is_known(scene.body, name)]
    if unknown or len(set(names)) != len(names) or not names:
        raise InputError(f"parameters: got {list(names)}; expected different ones of {', '.join(PARAMETERS)}")
    both = [stem for stem in REGIONAL if stem in names and any(n.startswith(f"{stem}[") for n in names)]
    if both:
        raise InputError(f"parameters: got {both[0]} of the body and of its regions; name one or the others")
    if "friction" in names and not _rough(scene):
        raise InputError("parameters: got 'friction', but no obstacle has a friction coefficient > 0; give it one")
    if "contact_damping" in names and not scene.obstacles:
        raise InputError("parameters: got 'contact_damping', but the scene has no obstacle; give it one")
    if "floor_height" in names and not planes_of(scene):
        raise InputError("parameters: got 'floor_height', but the scene has no plane; give it one")
    if any(name.startswith("wind") for name in names) and (scene.wind is None or callable(scene.wind.velocity)):
        raise InputError(
            "parameters: got a wind velocity, but the scene has no constant wind; give it `wind=Wind(...)`"
        )


def region_of(name: str) -> tuple[str, int | None]:
    """`density[2]` → (`density`, 2); `density` → (`density`, None)."""
    stem, bracket, number = name.partition("[")
    return (stem, int(number[:-1])) if bracket and number[:-1].isdecimal() and number.endswith("]") else (name, None)


def _is_known(body: ReducedBody, name: str) -> bool:
    stem, region = region_of(name)
    if region is None:
        return name in PARAMETERS or _flows_by(body, name)
    return stem in REGIONAL and body.regions is not None and region <= int(body.regions.max())


def _flows_by(body: ReducedBody, name: str) -> bool:
    """Whether a name is a constant of the body's flow rule."""
    return name in FLOW_PARAMETERS and body.flow is not None and hasattr(body.flow, name)


def cells_of(body: ReducedBody, region: int | None) -> Float[np.ndarray, " C"]:
    """One at the cells of a region (or of the whole body), zero elsewhere."""
    if region is None or body.regions is None:
        return np.ones(len(body.density))
    return (body.regions == region).astype(np.float64)


def axis_of(name: str) -> tuple[str, int]:
    """`gravity_z` → (`gravity`, 2)."""
    stem, _, axis = name.rpartition("_")
    return stem, _AXES[axis]


def _rough(scene: ReducedScene) -> list[float]:
    return [obstacle.friction for obstacle in scene.obstacles if obstacle.friction > 0]


def planes_of(scene: ReducedScene) -> list[Plane]:
    """The planes among the obstacles."""
    return [obstacle for obstacle in scene.obstacles if isinstance(obstacle, Plane)]


def _wind(scene: ReducedScene) -> Wind:
    assert scene.wind is not None
    return scene.wind


def mean_constant(body: ReducedBody, constant: Float[np.ndarray, " C"], region: int | None = None) -> float:
    """Volume average of a constant given per cell, over the body or a region."""
    interior = body.space.samples.interior
    volumes = interior.weights * cells_of(body, region)[interior.cells]
    return float(volumes @ constant[interior.cells] / volumes.sum())


def mean_density(body: ReducedBody, region: int | None = None) -> float:
    """Mass over volume [kg/m³], of the body or a region."""
    if region is None:
        return body.total_mass / body.volume
    return mean_constant(body, body.density, region)


def parameter_values(scene: ReducedScene, names: Sequence[str]) -> Float[np.ndarray, " P"]:
    """Present values of the named parameters, shape [P]."""
    check_parameters(scene, names)
    return np.array([_read(scene, name) for name in names])


def _read(scene: ReducedScene, name: str) -> float:
    body = scene.body
    stem, region = region_of(name)
    match stem:
        case "log10_youngs_modulus":
            return float(np.log10(mean_constant(body, body.youngs_modulus, region)))
        case "poisson_ratio":
            return mean_constant(body, body.poisson_ratio, region)
        case "density":
            return mean_density(body, region)
        case "damping_time" | "air_drag" | "contact_damping":
            return float(getattr(scene, name))
        case "friction":
            return float(np.mean(_rough(scene)))
        case "floor_height":
            return float(np.mean([np.dot(plane.point, plane.normal) for plane in planes_of(scene)]))
        case "log10_contact_stiffness":
            return float(np.log10(scene.contact().stiffness))
    if _flows_by(body, name):
        return float(getattr(body.flow, name))
    stem, axis = axis_of(name)
    if stem == "initial_position":
        return float((body.first_moments @ scene.start / body.total_mass)[axis])
    if stem == "wind":
        return float(_wind(scene).velocity_at(0.0)[axis])
    return float(getattr(scene, stem)[axis])


def with_parameters(scene: ReducedScene, names: Sequence[str], values: Float[np.ndarray, " P"]) -> ReducedScene:
    """The same scene with the named parameters set; the others are unchanged.

    Raises:
        InputError: unknown names, or values out of range.
    """
    check_parameters(scene, names)
    order = [*PARAMETERS, *FLOW_PARAMETERS]
    for name, value in sorted(zip(names, values, strict=True), key=lambda pair: order.index(region_of(pair[0])[0])):
        scene = _set(scene, name, float(value))
    return scene


def _set(scene: ReducedScene, name: str, value: float) -> ReducedScene:
    body, before = scene.body, _read(scene, name)
    change, (stem, region) = value - before, region_of(name)
    here = cells_of(body, region)
    changed: dict[str, Any]
    match stem:
        case "log10_youngs_modulus":
            changed = {"body": body.with_material(youngs_modulus=body.youngs_modulus * 10 ** (change * here))}
        case "poisson_ratio":
            changed = {"body": body.with_material(poisson_ratio=body.poisson_ratio + change * here)}
        case "density":
            changed = {"body": body.with_material(density=body.density * (value / before) ** here)}
        case "damping_time" | "air_drag" | "contact_damping":
            changed = {stem: value}
        case "friction":
            rougher = (replace(o, friction=o.friction + change) if o.friction else o for o in scene.obstacles)
            changed = {"obstacles": tuple(rougher)}
        case "floor_height":
            changed = {"obstacles": tuple(_raised(obstacle, change) for obstacle in scene.obstacles)}
        case "log10_contact_stiffness":
            changed = {"contact_stiffness": 10**value}
        case _ if _flows_by(body, name):
            flow: Any = body.flow
            changed = {"body": body.with_flow(replace(flow, **{name: value}))}
        case _:
            changed = _shifted(scene, *axis_of(name), change)
    return replace(scene, **changed)


def _raised(obstacle: Obstacle, by: float) -> Obstacle:
    """A plane moved along its normal; others stay."""
    if not isinstance(obstacle, Plane):
        return obstacle
    return replace(obstacle, point=np.asarray(obstacle.point) + by * np.asarray(obstacle.normal))


def _shifted(scene: ReducedScene, stem: str, axis: int, change: float) -> dict[str, Any]:
    """Vectors of the scene with one component changed."""
    step = change * np.eye(3)[axis]
    match stem:
        case "initial_position":
            return {"initial_coordinates": scene.unturned + scene.body.space.affine(np.zeros((3, 3)), step)}
        case "wind":
            wind = _wind(scene)
            return {"wind": replace(wind, velocity=wind.velocity_at(0.0) + step)}
    return {stem: np.asarray(getattr(scene, stem), dtype=np.float64) + step}
