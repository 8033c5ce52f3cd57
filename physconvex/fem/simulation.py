"""Preparation of a scene of finite elements for its roll-out, and its static equilibrium."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import PreparedRollOut, State, Timing, minimise
from physconvex.errors import InputError
from physconvex.fem.carried_contact import CarriedContact
from physconvex.fem.condensed_contact import CondensedContact
from physconvex.fem.nodal_equations import NodalEquations
from physconvex.fem.scene import Scene
from physconvex.numerics import one_torch_thread

_STALE_RATE = 0.25
_TOLERANCE = 1e-7  # of Newton's last step, over the size
_MARGIN = 0.03  # of the size: within this distance of an obstacle it may touch
_LOOKS = 8  # tests within a frame


def prepared_scene(scene: Scene, timing: Timing) -> PreparedRollOut:
    """A scene prepared for its roll-out, as `physconvex.dynamics.simulate` needs it."""
    _check(scene, timing)
    length = (timing.tolerance or _TOLERANCE) * scene.body.mesh.size
    equations = NodalEquations(scene)
    condensed = CondensedContact(equations, length) if timing.contact_solver == "condensed" else None
    return PreparedRollOut(
        equations,
        State(0.0, scene.start.copy(), scene.start_velocities()),
        length,
        _STALE_RATE,
        Flight(scene, timing).steps,
        solve=None if condensed is None else condensed.solve,
    )


def _check(scene: Scene, timing: Timing) -> None:
    if timing.energy_tolerance is not None:
        raise InputError("energy_tolerance: got one for finite elements, whose energies are not watched; leave it out")
    lagged = scene.body.flow is not None and scene.body.flow.lagged
    only_by_passes = {
        "contact_damping": scene.contact_damping > 0,
        "a flow that takes its pressure from the last pass": lagged,
        "a hanging load": scene.hanging is not None,
    }
    found = [what for what, there in only_by_passes.items() if there]
    if timing.contact_solver == "condensed" and found:
        raise InputError(f"contact_solver: got 'condensed' with {' and '.join(found)}; expected 'passes' there")


class Flight:
    """Steps per frame of a roll-out, evaluated frame by frame: a flying body moves slowly, an impact needs short steps.

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
        self._nodes = contact.nodes
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


@one_torch_thread()
def solve_static(scene: Scene, *, tolerance: float = 1e-9, load_steps: int = 1) -> Float[np.ndarray, "V 3"]:
    """Static equilibrium positions [m], shape [V, 3], of a pinned body under its forces.

    Args:
        scene: needs pins or contacts that hold the body; velocities and damping have no effect.
        tolerance: Newton's last step, relative to the body's size.
        load_steps: number of equal parts in which the forces are applied.

    Raises:
        ConvergenceError: Newton's method failed; more load steps may help.
    """
    if load_steps < 1:
        raise InputError(f"load_steps: got {load_steps}; expected at least 1")
    equations = NodalEquations(scene)
    x = scene.start.copy()
    if scene.held is not None:
        x[scene.held.nodes] = scene.held.positions(0.0, scene.start)
    total = equations.forces
    for part in range(1, load_steps + 1):
        equations.forces = total * (part / load_steps)
        limit = tolerance * scene.body.mesh.size
        x = minimise(equations, x, tolerance=limit, max_iterations=300, reuse=False).x
    return x
