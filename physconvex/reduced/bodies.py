"""Several reduced bodies in one scene, with contact and friction between them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Contact, FrameStates, PreparedRollOut, Timing
from physconvex.errors import InputError
from physconvex.reduced.pair_contact import PairContact
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.trajectory import BodiesTrajectory, ReducedTrajectory

_REACH = 0.02  # share of the smaller body's size


@dataclass(frozen=True)
class ReducedBodies:
    """Bodies that touch each other, each with its own obstacles, forces and initial motion.

    Contact between bodies with the stiffnesses k₁ and k₂ [Pa/m] and smoothings ε₁ and ε₂ acts like springs in series,
    with k₁ k₂/(k₁ + k₂) and ε₁ + ε₂. A collision of mirror images then equals that of one of them with a smooth wall.

    Attributes:
        scenes: one per body; common inputs (gravity, the floor) are given in each.
        friction: Coulomb coefficient between any two bodies [-], or a symmetric matrix of them.

    Raises:
        InputError: no scene, a body without a shell, or a friction out of range or of the wrong shape.
    """

    scenes: tuple[ReducedScene, ...]
    friction: float | Float[np.ndarray, "B B"] = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "scenes", tuple(self.scenes))
        if not self.scenes:
            raise InputError("scenes: got none; expected at least one body")
        for number, scene in enumerate(self.scenes):
            if scene.body.space.samples.shell is None:
                raise InputError(
                    f"scenes: body {number} has no shell, so that nothing can touch it; give its samples one "
                    "(`dataclasses.replace(samples, shell=Shell(points, faces))`)"
                )
        friction, count = np.asarray(self.friction, dtype=np.float64), len(self.scenes)
        if friction.shape not in ((), (count, count)) or not (np.isfinite(friction) & (friction >= 0)).all():
            raise InputError(f"friction: got {self.friction!r}; expected a number ≥ 0 or a [{count}, {count}] matrix")
        if not np.array_equal(friction, friction.T):
            raise InputError("friction: the matrix is not symmetric")
        object.__setattr__(self, "friction", np.broadcast_to(friction, (count, count)).copy())

    def prepared(self, timing: Timing) -> PreparedRollOut:
        """Prepared for `physconvex.dynamics.simulate`."""
        from physconvex.reduced.simulation import prepared_roll_out  # late: the equations of a scene know the scene

        return prepared_roll_out(self, timing)

    def trajectory(self, frames: FrameStates) -> BodiesTrajectory:
        """The roll-out."""
        bodies = tuple(
            ReducedTrajectory(
                scene.body.space,
                frames.times,
                frames.positions[:, where],
                frames.velocities[:, where],
                frames.statistics,
                frames.flowed(number),
            )
            for number, (scene, where) in enumerate(zip(self.scenes, self.slices, strict=True))
        )
        return BodiesTrajectory(frames.times, bodies, frames.statistics)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Slice of each body's coordinates among those of all."""
        ends = np.cumsum([0, *(scene.body.space.dimension for scene in self.scenes)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    @property
    def size(self) -> float:
        """Size of the smallest body [m]."""
        return min(scene.body.space.samples.size for scene in self.scenes)

    def pairs(self) -> list[tuple[int, int, PairContact]]:
        """Points of the first body against the shell of the second one, for all ordered pairs."""
        return [(a, b, self._pair(a, b)) for a, b in permutations(range(len(self.scenes)), 2)]

    def _pair(self, a: int, b: int) -> PairContact:
        first, second = self.scenes[a].contact(), self.scenes[b].contact()
        law = Contact(
            obstacles=(),
            areas=first.areas,
            stiffness=first.stiffness * second.stiffness / (first.stiffness + second.stiffness),
            smoothing=first.smoothing + second.smoothing,
            slip_velocity=min(first.slip_velocity, second.slip_velocity),
        )
        inner, outer = self.scenes[a].body.space, self.scenes[b].body.space
        shell = outer.samples.shell
        assert shell is not None and isinstance(self.friction, np.ndarray)
        return PairContact(
            law,
            float(self.friction[a, b]),
            inner.surface_values,
            outer.shape_values(shell.points),
            shell.faces,
            reach=_REACH * min(inner.samples.size, outer.samples.size),
        )
