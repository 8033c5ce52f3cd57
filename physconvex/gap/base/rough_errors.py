"""What a rough model errs by: little while a body flies, a hundredth of its size once it has touched something.

A fit that takes each frame at its stated noise lets the frames after an impact, which no rough model follows, bend the
flight: a spin that ten frames of flight tell to a tenth of a degree came out with the wrong sign. Numerical
differences, which tell the errors of the later fits, are only known once there is a rough one.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import simulate
from physconvex.errors import ConvergenceError
from physconvex.gap.base.observed_points import Seen, in_metres, widened
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.thresholds import BASE_FIT
from physconvex.identify import Twin

__all__ = ["rough_error_by_frame", "with_rough_errors"]


def with_rough_errors(seen: Seen, twin: Twin, frames: int) -> Seen:
    """Observations of the first frames, their noise widened by what a rough model of a free body errs by.

    As they are of a held body, and where the twin cannot be simulated.

    Args:
        seen: the observations.
        twin: rough as it is, it flies as the body does.
        frames: so many.
    """
    seen = seen.in_frames(frames)
    if twin.clamp is not None:
        return seen
    try:
        run = simulate(twin.scene, twin.timing(frames))
    except ConvergenceError:
        return seen
    space = twin.scene.body.space
    shapes = space.shape_values(seen.points)
    motion = PointMotion(
        seen.points, run.times, shapes @ run.coordinates, shapes @ run.velocities, getattr(seen, "camera", None)
    )
    surface = space.surface_values @ run.coordinates
    error = rough_error_by_frame(twin, run.times, surface, (space.surface_values @ run.velocities).mean(1), motion)
    return widened(seen, 1.0 + (error[seen.frames] / in_metres(seen, motion)) ** 2)


def rough_error_by_frame(
    twin: Twin,
    times: Float[np.ndarray, " T"],
    surface: Float[np.ndarray, "T V 3"],
    velocities: Float[np.ndarray, "T 3"],
    motion: PointMotion,
) -> Float[np.ndarray, " T"]:
    """Error of each frame [m].

    Args:
        twin: the body and its obstacles.
        times: of the frames [s].
        surface: points all over the surface [m].
        velocities: mean of the surface [m/s].
        motion: of the observed points.
    """
    size = twin.mesh.size
    error = BASE_FIT.flying * np.linalg.norm(motion.positions - motion.rest, axis=-1).mean(1)
    near = np.array(
        [
            any((o.gap(x, float(t)) < BASE_FIT.near * size).any() for o in twin.scene.obstacles)
            for x, t in zip(surface, times, strict=True)
        ]
    )
    gravity = np.asarray(twin.scene.gravity, dtype=np.float64)
    pushed = np.linalg.norm(np.diff(velocities, axis=0) - gravity * np.diff(times)[:, None], axis=1)
    near[1:] |= pushed > BASE_FIT.pushed * np.linalg.norm(gravity) * np.diff(times)
    touched = np.flatnonzero(near)
    if len(touched) and twin.scene.obstacles:
        error[touched[0] :] = np.maximum(error[touched[0] :], BASE_FIT.touched * size)
    return np.asarray(error)
