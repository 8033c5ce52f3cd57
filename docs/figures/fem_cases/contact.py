"""Friction on a slope and in an impact, against Coulomb's law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import box_mesh

__all__ = ["GRAVITY", "Impact", "Slope", "impact", "slope"]

GRAVITY = 9.81


@dataclass(frozen=True)
class Slope:
    """A slab on slopes: angles [degree], accelerations along the slope [m/s²], and Coulomb's."""

    friction: float
    angles: list[float]
    accelerations: list[float]
    coulomb: list[float]


def slope(angles: Sequence[float], friction: float = 0.5) -> Slope:
    """Slab of 0.2 × 0.2 × 0.05 m, E 2e5 Pa, gravity tilted; acceleration between 0.1 and 0.3 s."""
    accelerations = []
    for angle in np.radians(angles):
        body = ElasticBody(box_mesh((0.2, 0.2, 0.05), (2, 2, 1)), youngs_modulus=2e5, poisson_ratio=0.3)
        gravity = (GRAVITY * np.sin(angle), 0, -GRAVITY * np.cos(angle))
        scene = Scene(body, gravity=gravity, obstacles=(Plane(friction=friction),), damping_time=2e-3)
        run = simulate(scene, Timing(frames=4, fps=10, steps_per_frame=40))
        speed = np.einsum("v,tv->t", body.node_masses, run.velocities[:, :, 0]) / body.total_mass
        accelerations.append(float(np.polyfit(run.times[1:], speed[1:], 1)[0]))
    law = [max(0.0, GRAVITY * (np.sin(a) - friction * np.cos(a))) for a in np.radians(angles)]
    return Slope(friction, list(angles), accelerations, law)


@dataclass(frozen=True)
class Impact:
    """Tangential over normal impulse of a sliding impact; μ is what Coulomb's law gives."""

    friction: float
    youngs_modulus: float
    steps_per_second: int
    passes: int
    ratio: float


def impact(youngs_modulus: float, *, passes: int, friction: float = 0.2, steps_per_second: int = 400) -> Impact:
    """Block of 0.2 × 0.2 × 0.1 m that hits a plane at 2 m/s while it slides at 4 m/s, without gravity."""
    body = ElasticBody(box_mesh((0.2, 0.2, 0.1), (2, 2, 1)), youngs_modulus=youngs_modulus, poisson_ratio=0.3)
    floor = Plane(point=(0, 0, -0.02), friction=friction)
    scene = Scene(body, gravity=(0, 0, 0), obstacles=(floor,), initial_velocity=(4.0, 0, -2.0))
    run = simulate(scene, Timing(frames=2, fps=8, steps_per_frame=steps_per_second // 8, friction_passes=passes))
    speed = np.einsum("v,tvi->ti", body.node_masses, run.velocities) / body.total_mass
    change = speed[1] - speed[0]
    return Impact(friction, youngs_modulus, steps_per_second, passes, float(-change[0] / change[2]))
