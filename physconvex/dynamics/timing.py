"""Time discretisation of a roll-out: frames, time steps, tolerances of each step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from physconvex.dynamics.integrators import IntegratorName
from physconvex.errors import InputError

ContactSolver = Literal["passes", "condensed"]


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Frames and time steps of a roll-out.

    Attributes:
        frames: number of states to return, the first at t = 0.
        fps: frames per second [1/s].
        steps_per_frame: time steps between frames.
        integrator: "bdf2" (second order, first step implicit Euler) or "implicit_euler".
        tolerance: Newton's last step, relative to the body's size; None: the default of the model (1e-7 for finite
            elements, 3e-8 for reduced bodies). It is also the error of derivatives.
        friction_passes: most linearisations of friction (and of the pressure in sand) in each step; fewer if the
            velocities change by at most the scene's `slip_velocity`. One is explicit in the friction weights. See
            docs/decisions/001-frozen-friction.md.
        energy_tolerance: steps that raise the energy of an autonomous reduced scene by more than this share of its
            `energy_scale` are halved; None: not. Without it, impacts shorter than a step gain up to some hundredths.
            Derivatives by parameters jump where the number of halved steps changes.
        contact_solver: "passes" minimises with frozen friction, repeatedly; "condensed" (finite elements) solves
            contact and friction together on the touching points (`physconvex.fem.condensed_contact`): nothing is
            frozen, and factors last longer. If passes converge, both give the same result.
        flight_steps_per_frame: time steps in frames in which the body (of finite elements) has not touched an obstacle
            and does not come near one, except the first frame; `steps_per_frame` unless given.

    Raises:
        InputError: a value out of range.
    """

    frames: int = 24
    fps: float = 24.0
    steps_per_frame: int = 16
    integrator: IntegratorName = "bdf2"
    tolerance: float | None = None
    friction_passes: int = 12
    energy_tolerance: float | None = None
    contact_solver: ContactSolver = "passes"
    flight_steps_per_frame: int | None = None

    def __post_init__(self) -> None:
        steps = (self.steps_per_frame, self.flight_steps_per_frame or 1)
        if self.frames < 1 or min(steps) < 1 or not (np.isfinite(self.fps) and self.fps > 0):
            raise InputError(
                f"frames, steps_per_frame, fps: got {self.frames}, {self.steps_per_frame}, {self.fps}; expected > 0"
            )
        if self.friction_passes < 1:
            raise InputError(f"friction_passes: got {self.friction_passes}; expected at least 1")
        for name in ("tolerance", "energy_tolerance"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InputError(f"{name}: got {value}; expected a positive share, or None")
        for name, choices in (("integrator", IntegratorName), ("contact_solver", ContactSolver)):
            if getattr(self, name) not in get_args(choices):
                expected = " or ".join(repr(choice) for choice in get_args(choices))
                raise InputError(f"{name}: got {getattr(self, name)!r}; expected {expected}")

    @property
    def steps(self) -> int:
        """Time steps of the whole roll-out, with the usual number in every frame."""
        return (self.frames - 1) * self.steps_per_frame

    def every_step(self, ahead: float = 0.0) -> Timing:
        """The same time steps, each of them a frame, continued at least that long beyond the last frame [s]."""
        beyond = max(int(np.ceil(ahead * self.fps - 1e-9)), 0)
        frames = (self.frames - 1 + beyond) * self.steps_per_frame + 1
        return replace(self, frames=frames, fps=self.fps * self.steps_per_frame, steps_per_frame=1)
