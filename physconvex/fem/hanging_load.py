"""A load that hangs loosely: it falls by itself until its string is taut, and moves with the body's nodes from then on.

While the string is slack the load falls freely, g t²/2. Once the nodes that it hangs on (their mean, weighted by the
load's masses) have come down by less than that minus the slack, the string is taut: an inelastic impact, after which
the load's mass is the nodes'. Of the time step in which that happens, the part before leaves the load alone, so that
the motion depends smoothly on the slack. The load keeps a velocity history of its own, by which BDF2 gives it the
momentum it arrives with. A string that is taut once stays so. Without slack the load is fixed to the nodes, whose
velocity it has from the start.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import HangingLoad, State, StepCoefficients


class Hanging:
    """State of a hanging load from step to step.

    Args:
        load: its slack.
        masses: that hang on the nodes [kg], shape [V].
        gravity: [m/s²].
        start: positions of the nodes at t = 0 [m], shape [V, 3].
    """

    def __init__(
        self,
        load: HangingLoad,
        masses: Float[np.ndarray, " V"],
        gravity: Float[np.ndarray, " 3"],
        start: Float[np.ndarray, "V 3"],
    ) -> None:
        self.load, self.gravity, self.start = load, np.asarray(gravity, dtype=np.float64), start
        self.masses = masses
        size = float(np.linalg.norm(self.gravity))
        self._down = self.gravity / size if size > 0 else np.zeros(3)
        self._last: np.ndarray | None = None  # the load's velocity at the nodes, once taut
        self._before: np.ndarray = np.zeros_like(start)
        self.share = 0.0  # of the step during which it is taut
        self.target = np.zeros_like(start)
        self._pending: tuple[np.ndarray, float, float] | None = None

    @property
    def active(self) -> Float[np.ndarray, " V"]:
        """Masses that move with the nodes during this step [kg]."""
        return self.share * self.masses

    def _reach(self, x: np.ndarray, time: float) -> float:
        """How far the load has fallen beyond what its string allows [m]."""
        sunk = float(self.masses @ ((x - self.start) @ self._down) / self.masses.sum())
        return 0.5 * float(np.linalg.norm(self.gravity)) * time**2 - sunk - self.load.slack

    def set_step(self, c: StepCoefficients, time: float, guess: np.ndarray, last: State) -> None:
        """Share of the step in which the string is taut, and where the load would go by itself."""
        self._pending = None
        if self._last is not None:
            self.share, last_velocity, before = 1.0, self._last, self._before
        elif self.load.slack == 0:
            self.share, last_velocity, before = 1.0, last.velocities, last.velocities
        else:
            now, then = self._reach(last.positions, last.time), self._reach(guess, time)
            if then <= 0:
                self.share = 0.0
                return
            self.share = 1.0 if now >= 0 else float(then / (then - now))
            last_velocity = np.broadcast_to(self.gravity * last.time, self.start.shape)
            before = np.broadcast_to(self.gravity * (2 * last.time - time), self.start.shape)
        drift = (c.target - c.base) / c.step
        history = last_velocity if np.allclose(drift, last.velocities) else (4.0 * last_velocity - before) / 3.0
        self.target = c.base + c.step * history
        self._pending = (np.array(last_velocity), self.share, time - last.time)

    def force(self) -> Float[np.ndarray, "V 3"]:
        """Weight of what is taut [N]."""
        return self.active[:, None] * self.gravity

    def commit(self, velocity: Float[np.ndarray, "V 3"]) -> None:
        """The step has been taken, the nodes move with `velocity` [m/s] at its end."""
        if self._pending is None:
            return
        last, share, step = self._pending
        first = self._last is None
        self._before = last
        fallen = last + step * self.gravity
        self._last = share * velocity + (1 - share) * fallen if first else velocity.copy()
