"""Motion of simulated points, at the frames and between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from physconvex.io import Camera

Positions = Float[np.ndarray, "T P 3"]


@dataclass(frozen=True)
class PointMotion:
    """Positions of points at the frames.

    Attributes:
        rest: rest positions of the points [m], shape [P, 3].
        times: times of the frames [s], shape [T].
        positions: [m], shape [T, P, 3].
        velocities: [m/s], shape [T, P, 3].
        camera: the observing camera.
        steps: the same motion at the time steps, as far beyond the last frame as a clock needs; None if only the frames
            are known. The steps matter because a body reverses at the floor within a fraction of a frame.
    """

    rest: Float[np.ndarray, "P 3"]
    times: Float[np.ndarray, " T"]
    positions: Positions
    velocities: Positions
    camera: Camera | None = None
    steps: PointMotion | None = None

    @classmethod
    def of_steps(cls, steps: PointMotion, frames: int, every: int) -> PointMotion:
        """Build from a motion in time steps; every `every`-th one is a frame."""
        times, positions, velocities = (
            part[::every][:frames] for part in (steps.times, steps.positions, steps.velocities)
        )
        return cls(steps.rest, times, positions, velocities, steps.camera, steps)

    def first(self, count: int) -> PointMotion:
        """The first frames; the steps between and beyond them stay."""
        return replace(
            self, times=self.times[:count], positions=self.positions[:count], velocities=self.velocities[:count]
        )

    @property
    def end(self) -> float:
        """Time at which the known motion ends [s]."""
        return float((self if self.steps is None else self.steps).times[-1])

    def at(self, times: np.ndarray) -> Positions:
        """Positions at other times [s], one per frame [T] or per frame and point [T, P]; linear beyond the ends.

        A difference between positions at frames and steps (by another effect, say) moves with the time.
        """
        if times.ndim == 1:
            return self._at(times, self.positions, slice(None))
        columns = [self._at(times[:, p], self.positions[:, p], p) for p in range(times.shape[1])]
        return np.stack(columns, axis=1)

    def _at(self, times: np.ndarray, positions: np.ndarray, points: slice | int) -> np.ndarray:
        known = self if self.steps is None else self.steps
        spline = CubicHermiteSpline(known.times, known.positions[:, points], known.velocities[:, points], axis=0)
        inside = np.clip(times, known.times[0], known.times[-1])
        beyond = (times - inside).reshape(-1, *np.ones(positions.ndim - 1, dtype=int))
        out = spline(inside) + beyond * spline(inside, 1)
        apart = positions - spline(self.times)
        if len(self.times) > 1 and apart.any():
            out = out + PchipInterpolator(self.times, apart)(np.clip(times, self.times[0], self.times[-1]))
        return np.asarray(out)


@dataclass(frozen=True)
class MotionCorrection:
    """Change by a finer model, added to every motion of a model.

    Attributes:
        positions: at the frames [m], shape [T, P, 3].
        steps: the part that is known in time steps; a change at an impact begins between frames.
    """

    positions: Positions
    steps: PointMotion | None = None

    @classmethod
    def between(cls, exact: PointMotion, own: PointMotion) -> MotionCorrection:
        """Difference of a motion to another one of the same frames."""
        steps = None
        if exact.steps is not None and own.steps is not None:
            count = min(len(exact.steps.times), len(own.steps.times))
            a, b = exact.steps.first(count), own.steps.first(count)
            if np.allclose(a.times, b.times):
                steps = replace(a, positions=a.positions - b.positions, velocities=a.velocities - b.velocities)
        return cls(exact.positions - own.positions, steps)

    def of(self, motion: PointMotion) -> PointMotion:
        """The corrected motion; the correction continues linearly if its steps end before those of the motion."""
        positions = motion.positions + self.positions[: len(motion.times)]
        if self.steps is None or motion.steps is None:
            return replace(motion, positions=positions)
        whole, known = motion.steps, self.steps
        more = (whole.times[len(known.times) :] - known.times[-1])[:, None, None]
        late = np.broadcast_to(known.velocities[-1], (len(more), *known.velocities.shape[1:]))
        added = np.concatenate([known.positions, known.positions[-1] + more * known.velocities[-1]])
        faster = np.concatenate([known.velocities, late])
        count = len(whole.times)
        steps = replace(whole, positions=whole.positions + added[:count], velocities=whole.velocities + faster[:count])
        return replace(motion, positions=positions, steps=steps)
