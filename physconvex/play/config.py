"""Configuration of `physconvex simulate`: object, material, forces, floor, basis and time, readable from YAML.

Units are SI; names that end in `_deg` are in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from physconvex.errors import InputError
from physconvex.io import FrozenConfig, read_tree, set_value, validated
from physconvex.materials import LawName

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]

_EXAMPLE = "material.youngs_modulus=1.0e5"


class StartConfig(FrozenConfig):
    """Initial state of the object.

    Attributes:
        size: longest edge [m]; null: that of the file.
        orientation_deg: rotations about x, then y, then z.
        position: horizontal position of its centre [m].
        drop_height: height of its lowest point above the floor, or above the previous object [m].
        velocity, angular_velocity: [m/s], [rad/s].
    """

    size: Positive | None = None
    orientation_deg: Vector = (0.0, 0.0, 0.0)
    position: tuple[Finite, Finite] = (0.0, 0.0)
    drop_height: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.5
    velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)


class BodyMaterialConfig(FrozenConfig):
    """Material: E [Pa], ν, density [kg/m³], Kelvin–Voigt time [s], and the constants of its kind.

    Plasticine needs a `yield_stress` [Pa], sand a `friction_angle_deg`, a viscoelastic body (standard linear solid) a
    `modulus_ratio` and a `relaxation_time` [s]. An elastic or viscoelastic body may have fibres (`fibre_direction` in
    the rotated object, `fibre_ratio` of their modulus to μ) and stiffen with strain (`stiffening`).
    """

    kind: Literal["elastic", "plasticine", "sand", "viscoelastic"] = "elastic"
    law: LawName = "neo_hookean"
    youngs_modulus: Positive = 1e5
    poisson_ratio: Annotated[float, Field(gt=-1, lt=0.5)] = 0.4
    density: Positive = 1000.0
    damping_time: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1e-3
    yield_stress: Positive | None = None
    friction_angle_deg: Annotated[float, Field(gt=0, lt=90)] | None = None
    modulus_ratio: Positive | None = None
    relaxation_time: Positive | None = None
    fibre_direction: Vector | None = None
    fibre_ratio: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    stiffening: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def check(self) -> BodyMaterialConfig:
        needed = {
            "plasticine": ("yield_stress",),
            "sand": ("friction_angle_deg",),
            "viscoelastic": ("modulus_ratio", "relaxation_time"),
        }
        for name in needed.get(self.kind, ()):
            if getattr(self, name) is None:
                raise ValueError(f"{name} is missing, which a material of kind {self.kind!r} needs")
        if self.fibre_ratio > 0 and self.fibre_direction is None:
            raise ValueError("fibre_direction is missing, which fibre_ratio > 0 needs")
        if self.kind in ("plasticine", "sand") and (self.fibre_ratio > 0 or self.stiffening > 0):
            raise ValueError(f"a material of kind {self.kind!r} has neither fibres nor stiffening")
        return self


class FloorConfig(FrozenConfig):
    """The plane z = 0: friction coefficient, velocity [m/s], and the period [s] of a sinusoidal velocity (null: the
    velocity is constant)."""

    friction: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.5
    velocity: Vector = (0.0, 0.0, 0.0)
    period: Positive | None = None


class ContactConfig(FrozenConfig):
    """Friction coefficient between objects."""

    friction: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.5


class ForceConfig(FrozenConfig):
    """Gravity [m/s²], a constant push (acceleration [m/s²]), wind [m/s] (null: no air), drag coefficient."""

    gravity: Vector = (0.0, 0.0, -9.81)
    push: Vector = (0.0, 0.0, 0.0)
    wind: Vector | None = None
    drag_coefficient: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.0


class BasisConfig(FrozenConfig):
    """Skinning weights of the reduced model.

    Attributes:
        kind: `elastic` weights come from vibrations and responses to contact forces, which two simulations locate; with
            thirty to sixty of them the error is smallest. `predicted` weights are a network's, from `file`.
        file: skinning weights that `physconvex predict` writes (`clips/NAME.skinning.safetensors`). Their frame is the
            file of the asset, with the origin in the centre of its bounding box; they grow and turn with the object.
        modes: number M of weights, unless a file has them; `seed`: of the neural field.
        max_nodes: most nodes of the background mesh; `mesher`: its method.
        contact_points: most vertices of the surface that can touch the floor.
    """

    kind: Literal["eigenmodes", "elastic", "neural", "predicted"] = "eigenmodes"
    file: str | None = None
    modes: int = Field(default=10, ge=1, le=64)
    seed: int = Field(default=0, ge=0)
    max_nodes: int = Field(default=500, ge=20)
    contact_points: int = Field(default=2000, ge=10)
    mesher: Literal["auto", "lattice", "ftetwild"] = "auto"

    @model_validator(mode="after")
    def check(self) -> BasisConfig:
        if self.kind == "predicted" and self.file is None:
            raise ValueError("file is missing, which predicted weights need: clips/NAME.skinning.safetensors")
        if self.kind != "predicted" and self.file is not None:
            raise ValueError(f"file is given, but the kind is {self.kind!r}; expected 'predicted'")
        return self


class ConvexesConfig(FrozenConfig):
    """Convex dynamics: convexes of a field that the motion bends are split (`physconvex.convex.adapt_to_motion`).

    Attributes:
        deviation: distance from an affine motion up to which a convex stays whole, as a share of the object's size.
        limit: most convexes after splitting; 0: none is split.
    """

    deviation: Positive = 5e-3
    limit: int = Field(default=20_000, ge=0)


class TimeConfig(FrozenConfig):
    """Number of frames, rate [1/s], time steps per frame, most friction passes per step, last Newton step relative to
    the size, gain of energy above which a step is halved (`physconvex.dynamics.Timing`)."""

    frames: int = Field(default=24, ge=1)
    fps: Positive = 24.0
    steps_per_frame: int = Field(default=8, ge=1)
    friction_passes: int = Field(default=12, ge=1)
    tolerance: Positive = 1e-5
    energy_tolerance: Positive | None = 1e-3


class PlayConfig(FrozenConfig):
    """All settings of `physconvex simulate`."""

    object: StartConfig = StartConfig()
    material: BodyMaterialConfig = BodyMaterialConfig()
    floor: FloorConfig | None = FloorConfig()
    contact: ContactConfig = ContactConfig()
    forces: ForceConfig = ForceConfig()
    basis: BasisConfig = BasisConfig()
    convexes: ConvexesConfig = ConvexesConfig()
    time: TimeConfig = TimeConfig()


def load_play_config(
    source: str | Path | None = None, *, overrides: Sequence[str] = (), found: Mapping[str, Any] | None = None
) -> PlayConfig:
    """Configuration from a preset name, a YAML file, or the defaults, with `section.name=value` overrides.

    Args:
        source: preset, file, or None.
        overrides: set over it.
        found: sections from the asset itself, such as a refined material; `source` and `overrides` override it.

    Raises:
        InputError: no such file or preset, bad YAML, an unknown name or a value out of range.
    """
    expected = "sections such as `material:`"
    tree = {} if source is None else read_tree(source, "physconvex.play", argument="preset", expected=expected)
    for section, values in (found or {}).items():
        if isinstance(tree.setdefault(section, {}), dict):
            tree[section] = {**values, **tree[section]}
    for override in overrides:
        if "." not in override.partition("=")[0]:
            raise InputError(f"--set: got {override!r}; expected section.name=value, as {_EXAMPLE}")
        set_value(tree, override, example=_EXAMPLE)
    return validated(PlayConfig, tree, argument="configuration")


def overrides_of(number: int, count: int, overrides: Sequence[str]) -> list[str]:
    """The overrides for object `number` of `count`: those for all, and those that start with its number (from 1) and
    a colon, for example `2:material.density=500`.

    Raises:
        InputError: the number of no object.
    """
    mine = []
    for override in overrides:
        owner, colon, rest = override.partition(":")
        if not colon or not owner.strip().isdigit():
            mine.append(override)
        elif not 1 <= int(owner) <= count:
            raise InputError(f"--set: got {override!r}, for object {owner} of {count}; expected 1 to {count}")
        elif int(owner) == number:
            mine.append(rest)
    return mine
