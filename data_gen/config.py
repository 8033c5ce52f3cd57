"""Configuration of the generator: all ranges that it samples, in a class that YAML files fill.

Units are SI; names that end in `_deg` are in degrees. A range is written as a number (fixed), `[low, high]`
(uniform), or `{low: …, high: …, scale: log}` (log-uniform).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from physconvex.dynamics import ContactSolver, Timing
from physconvex.io import FrozenConfig, read_tree, set_value, validated
from physconvex.materials import get_law


class Interval(FrozenConfig):
    """Closed interval with a uniform or log-uniform distribution."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def check(self) -> Interval:
        if not (np.isfinite([self.low, self.high]).all() and self.low <= self.high):
            raise ValueError(f"low {self.low} and high {self.high} must be finite with low ≤ high")
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f"low {self.low} must be positive on a log scale")
        return self

    def sample(self, rng: np.random.Generator) -> float:
        """One draw."""
        if self.scale == "log":
            return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        return float(rng.uniform(self.low, self.high))


def read_range(value: object) -> object:
    """Accept a number or a pair where an interval is wanted."""
    if isinstance(value, (int, float)):
        return {"low": value, "high": value}
    if isinstance(value, (list, tuple)) and len(value) == 2:
        return {"low": value[0], "high": value[1]}
    return value


Range = Annotated[Interval, BeforeValidator(read_range)]
Share = Annotated[float, Field(ge=0, le=1)]


def uniform(low: float, high: float) -> Interval:
    return Interval(low=low, high=high)


def log_uniform(low: float, high: float) -> Interval:
    return Interval(low=low, high=high, scale="log")


class ObjectSource(FrozenConfig):
    """Objects that fall.

    The meshes in `folder` replace the procedural bodies. A hash of the name assigns each object to training,
    validation or test; the rest of the two shares is test.
    """

    folder: str | None = None
    simulations_per_object: int = Field(default=2, ge=1)
    train_share: Share = 0.80
    validation_share: Share = 0.08


class MotionConfig(FrozenConfig):
    """Initial motion: size [m], height of the lowest point above the floor in sizes, speed [m/s], spin [rad/s]."""

    size: Range = log_uniform(0.5, 1.5)
    orientation: Literal["random", "upright", "given"] = "random"
    drop_height: Range = uniform(0.3, 1.5)
    initial_speed: Range = uniform(0.0, 0.5)
    initial_spin: Range = uniform(0.0, 2.0)
    friction: Range = uniform(0.2, 1.0)
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)


class MaterialRanges(FrozenConfig):
    """Material: law, E [Pa], ν, density [kg/m³], time constant of Kelvin–Voigt damping [s]."""

    law: str = "neo_hookean"
    youngs_modulus: Range = log_uniform(1e4, 1e7)
    poisson_ratio: Range = uniform(0.2, 0.49)
    density: Range = uniform(1000.0, 1000.0)
    damping_time: Range = log_uniform(5e-4, 2e-3)

    @model_validator(mode="after")
    def check(self) -> MaterialRanges:
        if self.poisson_ratio.low <= -1 or self.poisson_ratio.high >= 0.5:
            raise ValueError("poisson_ratio must lie inside (-1, 0.5)")
        if self.youngs_modulus.low <= 0 or self.density.low <= 0:
            raise ValueError("youngs_modulus and density must be positive")
        get_law(self.law)
        return self


class SolverConfig(FrozenConfig):
    """Discretisation of the simulation.

    Attributes:
        target_nodes: most nodes of the quadratic mesh; `landing_nodes`: most nodes added where the body lands.
        steps_per_frame: time steps per video frame; `flight_steps_per_frame`: most steps before the landing.
        touching: contact points: the nodes of the mesh, or points all over the visible surface that move with it.
        contact_solver: see `physconvex.dynamics.Timing`; `friction_passes`: most passes per step, for `passes`.
        tolerance: last step of Newton's method relative to the size of the body.
        max_attempts: draws before a simulation is given up.
    """

    target_nodes: int = Field(default=1000, ge=20)
    landing_nodes: int = Field(default=400, ge=0)
    steps_per_frame: int = Field(default=24, ge=1)
    flight_steps_per_frame: int = Field(default=8, ge=1)
    touching: Literal["nodes", "surface"] = "nodes"
    contact_solver: ContactSolver = "condensed"
    friction_passes: int = Field(default=12, ge=1)
    tolerance: float = Field(default=1e-5, gt=0)
    max_attempts: int = Field(default=6, ge=1)

    def timing(self, frames: int = 24, fps: float = 24.0) -> Timing:
        """Steps of a roll-out of so many frames, at that rate [1/s]."""
        return Timing(
            frames=frames,
            fps=fps,
            steps_per_frame=self.steps_per_frame,
            flight_steps_per_frame=min(self.flight_steps_per_frame, self.steps_per_frame),
            contact_solver=self.contact_solver,
            friction_passes=self.friction_passes,
            tolerance=self.tolerance,
        )


class VideoConfig(FrozenConfig):
    """Number of frames, rate [1/s], image size [pixels] (even, for H.264), samples per pixel and axis, x264 quality."""

    frames: int = Field(default=24, ge=2)
    fps: float = Field(default=24.0, gt=0)
    width: int = Field(default=128, ge=16, multiple_of=2)
    height: int = Field(default=128, ge=16, multiple_of=2)
    supersampling: int = Field(default=2, ge=1, le=4)
    crf: int = Field(default=18, ge=0, le=51)


class CameraConfig(FrozenConfig):
    """Position of the camera. Azimuth 0 looks along +y; `margin` is the free space around the expected path."""

    views: int = Field(default=3, ge=1)
    azimuth_deg: Range = uniform(-180.0, 180.0)
    elevation_deg: Range = uniform(2.0, 25.0)
    field_of_view_deg: Range = uniform(22.0, 55.0)
    margin: Range = uniform(1.03, 1.2)
    aim_jitter: float = Field(default=0.05, ge=0)


class AppearanceConfig(FrozenConfig):
    """Light, floor and background. Intensities are factors of the texture colour."""

    key_azimuth_deg: Range = uniform(-75.0, 75.0)
    key_elevation_deg: Range = uniform(35.0, 80.0)
    key_intensity: Range = uniform(0.65, 1.0)
    fill_intensity: Range = uniform(0.15, 0.4)
    ambient: Range = uniform(0.25, 0.45)
    specular: Range = uniform(0.0, 0.35)
    warmth: Range = uniform(-0.12, 0.12)
    shadow_softness: Range = log_uniform(0.004, 0.03)
    floor_tile: Range = log_uniform(0.5, 4.0)
    background_kinds: tuple[Literal["plain", "gradient", "texture"], ...] = ("plain", "gradient", "texture")


class DegradationConfig(FrozenConfig):
    """Degradations of real clips; each applies to its share of the views."""

    noise_share: Share = 0.5
    noise: Range = log_uniform(0.003, 0.03)
    compression_share: Share = 0.5
    compression_crf: Range = uniform(20.0, 33.0)
    blur_share: Share = 0.3
    shutter: Range = uniform(0.2, 0.7)
    blur_subframes: int = Field(default=4, ge=2)
    exposure_share: Share = 0.5
    exposure_stops: Range = uniform(-0.5, 0.4)
    white_balance: Range = uniform(-0.08, 0.08)
    gamma: Range = uniform(0.85, 1.2)
    shake_share: Share = 0.25
    shake: Range = log_uniform(0.001, 0.006)


class SampleConfig(FrozenConfig):
    """Number of interior points and skinning eigenmodes that are stored with each simulation."""

    points: int = Field(default=384, ge=4)
    modes: int = Field(default=16, ge=1)


class GeneratorConfig(FrozenConfig):
    """The whole configuration of a generated data set."""

    objects: ObjectSource = ObjectSource()
    motion: MotionConfig = MotionConfig()
    material: MaterialRanges = MaterialRanges()
    solver: SolverConfig = SolverConfig()
    video: VideoConfig = VideoConfig()
    camera: CameraConfig = CameraConfig()
    appearance: AppearanceConfig = AppearanceConfig()
    degradation: DegradationConfig = DegradationConfig()
    samples: SampleConfig = SampleConfig()


def load_config(source: str | Path | None = None, *, overrides: Sequence[str] = ()) -> GeneratorConfig:
    """Configuration from a preset name, a YAML file, or the defaults, with `section.name=value` overrides.

    Raises:
        InputError: no such file or preset, bad YAML, an unknown name or a value out of range.
    """
    expected = "sections such as `motion:`"
    tree = {} if source is None else read_tree(source, "data_gen", argument="config", expected=expected)
    for override in overrides:
        set_value(tree, override, example="material.poisson_ratio=[0.3,0.4]")
    return validated(GeneratorConfig, tree, argument="configuration")
