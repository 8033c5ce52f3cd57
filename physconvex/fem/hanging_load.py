"""A load on a string: it falls freely while the string is slack, and moves with the body's nodes once it is taut.

While the string is slack, the load falls by g t²/2. The string becomes taut when the mean descent of the nodes that it
hangs on, weighted by the load's masses, is less than that minus the slack. This is an inelastic impact, after which the
load's mass is added to the nodes. Within that time step the load is free until the impact, so that the motion depends
smoothly on the slack. The load keeps its own velocity history, from which BDF2 takes its momentum. A taut string stays
taut. Without slack the load is fixed to the nodes and starts with their velocity.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import HangingLoad, State, StepCoefficients


class Hanging:
    """State of a hanging load from step to step.

    Args:
        load: its slack.
        masses: hanging masses by node [kg], shape [V].
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
        """How far the load is below what its string permits [m]."""
        sunk = float(self.masses @ ((x - self.start) @ self._down) / self.masses.sum())
        return 0.5 * float(np.linalg.norm(self.gravity)) * time**2 - sunk - self.load.slack

    def set_step(self, c: StepCoefficients, time: float, guess: np.ndarray, last: State) -> None:
        """Share of the step in which the string is taut, and the position of the free load."""
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
        """Weight of the taut load [N]."""
        return self.active[:, None] * self.gravity

    def commit(self, velocity: Float[np.ndarray, "V 3"]) -> None:
        """Update after a step, at whose end the nodes have `velocity` [m/s]."""
        if self._pending is None:
            return
        last, share, step = self._pending
        first = self._last is None
        self._before = last
        fallen = last + step * self.gravity
        self._last = share * velocity + (1 - share) * fallen if first else velocity.copy()
