"""Number of time steps in a frame: fewer while a body flies and has not touched anything.

A flying body only falls and turns, which is slow; the impact and the vibrations after it need short steps.
"""

from __future__ import annotations

import numpy as np

from physconvex.dynamics import State, Timing
from physconvex.fem.carried_contact import CarriedContact
from physconvex.fem.scene import Scene

_MARGIN = 0.03  # of the size: within this distance of an obstacle it may touch
_LOOKS = 8  # tests within a frame


class Flight:
    """Steps per frame of a roll-out, evaluated frame by frame.

    Args:
        scene: the scene.
        timing: its `flight_steps_per_frame` applies while the body flies, except in the first frame, which starts the
            integrator.
    """

    def __init__(self, scene: Scene, timing: Timing) -> None:
        self.scene, self.duration, self.usual = scene, 1 / timing.fps, timing.steps_per_frame
        self.in_flight = timing.flight_steps_per_frame or timing.steps_per_frame
        contact = scene.contact()
        self._matrix = contact.carried.matrix if isinstance(contact, CarriedContact) else None
        law = contact.law if isinstance(contact, CarriedContact) else contact
        self._nodes = law.nodes
        self._flying = self.in_flight != self.usual and all(
            driven is None for driven in (scene.held, scene.loads, scene.push)
        )

    def steps(self, state: State) -> int:
        """Steps of the frame that begins with a state."""
        self._flying = self._flying and self._is_clear(state)
        return self.in_flight if self._flying and state.time > 0 else self.usual

    def _is_clear(self, state: State) -> bool:
        """Whether a ballistic flight through the frame stays clear of all obstacles."""
        gravity, margin = np.asarray(self.scene.gravity, dtype=np.float64), _MARGIN * self.scene.body.mesh.size
        for part in np.linspace(0.0, self.duration, _LOOKS + 1):
            x = state.positions + part * state.velocities + 0.5 * part**2 * gravity
            x = (x if self._matrix is None else self._matrix @ x)[self._nodes]
            if any(o.gap(x, state.time + part).min() <= margin for o in self.scene.obstacles):
                return False
        return True
