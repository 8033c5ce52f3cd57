"""Sizes, motions and changed conditions of the benchmark: objects fall on a rough floor, or are tossed up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self, get_args

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from data_gen.objects.library import ObjectMesh
from data_gen.objects.solids import random_direction
from physconvex import InputError
from physconvex.dynamics import ContactSolver, Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene, SurfacePoints
from physconvex.io import CommandLine, Options
from physconvex.mesh import TetMesh

DENSITY, FRICTION, HEIGHT = 1000.0, 0.4, 0.25  # kg/m³; coefficient; of the drop, in sizes
GRAVITY = 9.81  # m/s²
SPIN, ASKEW_DEG = (3.0, 5.0), 20.0  # rad/s; of the axis of a toss from the line of sight of the front camera, at most

_SOFTER, _PUSH, _SWING, _RATE = 0.3, 4.0, 0.8, 2.0

MotionName = Literal["drop", "toss"]


class BenchmarkOptions(Options):
    """Sizes of the benchmark; the defaults are those of the paper's tables."""

    count: Annotated[int, Field(ge=1)] = 12
    """Number of objects."""
    names: Annotated[tuple[str, ...] | None, CommandLine("--name")] = None
    """Choose this object by the name of its folder; repeatable. Default: evenly spread over the alphabet."""
    size: Annotated[int, Field(ge=64)] = 448
    """Width and height of the images [pixels]."""
    views: Annotated[int, Field(ge=2)] = 12
    """Number of cameras around the object."""
    observed_views: Annotated[int, Field(ge=1)] = 1
    """Number of cameras with a video, evenly spread; 1: the front camera. The others have a picture of frame 0."""
    motion: MotionName = "drop"
    """Motion: drop (onto a rough floor) or toss (upwards with spin, without a floor)."""
    frames: Annotated[int, Field(ge=2)] = 24
    """Number of frames."""
    observed_frames: Annotated[int, Field(ge=2)] = 16
    """Frames that may be fitted."""
    fps: Annotated[float, Field(ge=1)] = 24.0
    """Frames per second."""
    nodes: Annotated[int, Field(ge=50)] = 2500
    """Most nodes of the quadratic mesh of the truth."""
    fill: bool = True
    """Integrate mass and energy over the inside of the surface."""
    steps_per_frame: Annotated[int, Field(ge=1)] = 32
    """Time steps of the truth per frame."""
    checked: Annotated[bool, CommandLine("--check/--no-check")] = True
    """Measure how half the nodes and half the steps change the motion."""
    changed: Annotated[bool, CommandLine("--changes/--no-changes")] = True
    """Move every object also under changed conditions (softer, pushed, moving floor)."""
    log10_modulus: Annotated[tuple[float, float], CommandLine("--modulus")] = (4.0, 7.0)
    """Range of log10 E, E in Pa."""
    poisson_ratio: Annotated[tuple[float, float], CommandLine(hidden=True)] = (0.2, 0.49)
    """Range of ν."""
    damping_time: Annotated[tuple[float, float], CommandLine(hidden=True)] = (5e-4, 2e-3)
    """Range [s], log-uniform."""
    object_size: Annotated[float, CommandLine(hidden=True)] = 1.0
    """Largest edge [m]."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of everything random."""

    @model_validator(mode="after")
    def _within(self) -> Self:
        for name, got, most in (
            ("frames", self.observed_frames, self.frames),
            ("views", self.observed_views, self.views),
        ):
            if got > most:
                raise InputError(f"observed_{name}: got {got}; expected at most {name} = {most}")
        return self


@dataclass(frozen=True)
class BenchmarkMotion:
    """Initial motion of an object, and whether there is a floor.

    Attributes:
        velocity: of the centre of mass [m/s].
        spin: about it [rad/s].
        floor: rough, at z = 0.
    """

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    floor: bool = True


def draw_motion(name: MotionName, duration: float, rng: np.random.Generator) -> BenchmarkMotion:
    """Draw a motion; a drop has no random numbers.

    A toss is back at its initial height after `duration` [s]. The axis of its spin is close to the line of sight of the
    front camera, which looks along −x. The spin stretches the body, so that it vibrates; it is independent of the
    material.


    Raises:
        InputError: an unknown name.
    """
    if name not in get_args(MotionName):
        raise InputError(f"motion: got {name!r}; expected one of {', '.join(get_args(MotionName))}")
    if name == "drop":
        return BenchmarkMotion()
    rate, askew, about = rng.uniform(*SPIN), np.radians(rng.uniform(0, ASKEW_DEG)), rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(askew), np.sin(askew) * np.cos(about), np.sin(askew) * np.sin(about)])
    x, y, z = (float(v) for v in rng.choice([-1, 1]) * rate * axis)
    return BenchmarkMotion((0.0, 0.0, 0.5 * GRAVITY * duration), (x, y, z), floor=False)


def placed(body: ObjectMesh, size: float, rng: np.random.Generator) -> ObjectMesh:
    """Scaled to a largest edge of `size` [m], turned about a random axis by up to 25°, HEIGHT sizes above the floor."""
    body = body.scaled(size)
    turn = Rotation.from_rotvec(random_direction(rng) * np.radians(rng.uniform(5, 25)))
    x = turn.apply(body.vertices - body.vertices.mean(axis=0))
    x[:, 2] += HEIGHT * size - x[:, 2].min()
    return replace(body, vertices=x, signed_distance=None)


def scene_of(mesh: TetMesh, truth: dict[str, float], shown: ObjectMesh, motion: BenchmarkMotion) -> Scene:
    """The scene of a body with `truth`'s youngs_modulus [Pa], poisson_ratio and damping_time [s].

    The floor acts on the visible surface, since the mesh's own cuts its corners.
    """
    body = ElasticBody(
        mesh, youngs_modulus=truth["youngs_modulus"], poisson_ratio=truth["poisson_ratio"], density=DENSITY
    )
    return Scene(
        body,
        obstacles=(Plane(friction=FRICTION),) if motion.floor else (),
        damping_time=truth["damping_time"],
        initial_velocity=motion.velocity,
        initial_angular_velocity=motion.spin,
        contact_points=SurfacePoints.of_triangles(shown.vertices, shown.faces) if motion.floor else None,
    )


def rolled(scene: Scene, frames: int, fps: float, steps_per_frame: int) -> Float[np.ndarray, "T V 3"]:
    """Positions [m] of the nodes in all frames."""
    solver: ContactSolver = "condensed" if scene.obstacles else "passes"
    timing = Timing(frames=frames, fps=fps, steps_per_frame=steps_per_frame, contact_solver=solver)
    return simulate(scene, timing).positions


def _softer(scene: Scene) -> Scene:
    """E times 0.3, contact as stiff as it was."""
    body = scene.body
    softer = ElasticBody(
        body.mesh,
        law=body.law,
        youngs_modulus=_SOFTER * body.youngs_modulus,
        poisson_ratio=body.poisson_ratio,
        density=body.density,
    )
    return replace(scene, body=softer, contact_stiffness=scene.contact().stiffness)


def _pushed(scene: Scene) -> Scene:
    """A uniform acceleration of 4 m/s² along x in addition to gravity."""
    return replace(scene, gravity=np.asarray(scene.gravity) + np.array([_PUSH, 0.0, 0.0]))


def _moving_floor(scene: Scene) -> Scene:
    """The floor slides along x with 0.8 m/s · sin(2 π 2 Hz t)."""

    def velocity(time: float) -> tuple[float, float, float]:
        return (float(_SWING * np.sin(2 * np.pi * _RATE * time)), 0.0, 0.0)

    planes = tuple(replace(o, velocity=velocity) if isinstance(o, Plane) else o for o in scene.obstacles)
    return replace(scene, obstacles=planes)


CHANGES: dict[str, Callable[[Scene], Scene]] = {
    "softer": _softer,
    "pushed": _pushed,
    "moving_floor": _moving_floor,
}


def changes_of(scene: Scene) -> tuple[str, ...]:
    """The changes that apply to a scene: a moving floor needs a floor."""
    floor = any(isinstance(o, Plane) for o in scene.obstacles)
    return tuple(name for name in CHANGES if floor or name != "moving_floor")


def changed(scene: Scene, name: str) -> Scene:
    """The same body under a change.

    Raises:
        InputError: an unknown name.
    """
    if name not in CHANGES:
        raise InputError(f"change: got {name!r}; expected one of {', '.join(CHANGES)}")
    return CHANGES[name](scene)
