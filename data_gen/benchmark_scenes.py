"""What the objects of the benchmark do: fall on a rough floor, or are tossed up spinning and touch nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from data_gen.objects.library import ObjectMesh
from physconvex import InputError
from physconvex.dynamics import Plane
from physconvex.fem import ElasticBody, Scene, SurfacePoints, simulate
from physconvex.mesh import TetMesh

__all__ = ["DENSITY", "FRICTION", "MOTIONS", "Motion", "MotionName", "motion_of", "placed", "rolled", "scene_of"]

DENSITY, FRICTION, HEIGHT = 1000.0, 0.4, 0.25  # kg/m³; coefficient; of the drop, in sizes
GRAVITY = 9.81  # m/s²
SPIN, ASKEW_DEG = (3.0, 5.0), 20.0  # rad/s; of the axis of a toss from the line of sight of the front camera, at most

MotionName = Literal["drop", "toss"]
MOTIONS: tuple[MotionName, ...] = ("drop", "toss")


@dataclass(frozen=True)
class Motion:
    """How an object starts, and whether there is a floor.

    Attributes:
        velocity: of the centre of mass [m/s].
        spin: about it [rad/s].
        floor: rough, at z = 0.
    """

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    floor: bool = True


def motion_of(name: MotionName, duration: float, rng: np.random.Generator) -> Motion:
    """Draw a motion; that of a drop is always the same, and draws nothing.

    A toss is back at its height after `duration` [s]. Its spin, about nearly the line of sight of the front camera,
    which looks along −x, pulls the body apart, so that it vibrates; it says nothing of the material.

    Raises:
        InputError: an unknown name.
    """
    if name not in MOTIONS:
        raise InputError(f"motion: got {name!r}; expected one of {', '.join(MOTIONS)}")
    if name == "drop":
        return Motion()
    rate, askew, about = rng.uniform(*SPIN), np.radians(rng.uniform(0, ASKEW_DEG)), rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(askew), np.sin(askew) * np.cos(about), np.sin(askew) * np.sin(about)])
    x, y, z = (float(v) for v in rng.choice([-1, 1]) * rate * axis)
    return Motion((0.0, 0.0, 0.5 * GRAVITY * duration), (x, y, z), floor=False)


def placed(body: ObjectMesh, size: float, rng: np.random.Generator) -> ObjectMesh:
    """Scaled to a largest edge of `size` [m], turned about a random axis by up to 25°, HEIGHT sizes above the floor."""
    body = body.scaled(size)
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rng.uniform(5, 25)))
    x = turn.apply(body.vertices - body.vertices.mean(axis=0))
    x[:, 2] += HEIGHT * size - x[:, 2].min()
    return ObjectMesh(
        x, body.faces, body.name, body.family, vertex_colors=body.vertex_colors, uv=body.uv, texture=body.texture,
        licence=body.licence,
    )  # fmt: skip


def scene_of(mesh: TetMesh, truth: dict[str, float], shown: ObjectMesh, motion: Motion) -> Scene:
    """The scene of a body with `truth`'s youngs_modulus [Pa], poisson_ratio and damping_time [s].

    The floor acts on the surface that is shown, since the mesh's own cuts its corners.
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
    solver: Literal["condensed", "passes"] = "condensed" if scene.obstacles else "passes"
    run = simulate(scene, frames=frames, fps=fps, steps_per_frame=steps_per_frame, contact_solver=solver)
    return run.positions
