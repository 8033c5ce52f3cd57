"""Preparation of reduced scenes for their roll-outs."""

from __future__ import annotations

import numpy as np

from physconvex.dynamics import PreparedRollOut, State, Timing
from physconvex.errors import InputError
from physconvex.reduced.bodies import ReducedBodies
from physconvex.reduced.bodies_equations import BodiesEquations
from physconvex.reduced.dense_newton import DenseNewton
from physconvex.reduced.equations import ReducedEquations
from physconvex.reduced.scene import ReducedScene

_STALE_RATE = 0.5  # secants compensate for an old factor
_TOLERANCE = 3e-8  # of Newton's last step, over the size


def prepared_roll_out(world: ReducedScene | ReducedBodies, timing: Timing) -> PreparedRollOut:
    """One body or several, as `physconvex.dynamics.simulate` needs them; tolerances follow the smallest one."""
    if timing.contact_solver != "passes" or timing.flight_steps_per_frame is not None:
        raise InputError(
            "contact_solver, flight_steps_per_frame: got "
            f"{timing.contact_solver!r}, {timing.flight_steps_per_frame} for a reduced body; expected contact by "
            "passes and steps of one length. Leave both out"
        )
    equations: DenseNewton
    if isinstance(world, ReducedBodies):
        equations, scenes, size = BodiesEquations(world), world.scenes, world.size
    else:
        equations, scenes, size = ReducedEquations(world), (world,), world.body.space.samples.size
    guarded = timing.energy_tolerance is not None and all(scene.autonomous for scene in scenes)
    start = State(
        0.0,
        np.concatenate([scene.start for scene in scenes]),
        np.concatenate([scene.start_velocities() for scene in scenes]),
    )
    return PreparedRollOut(
        equations,
        start,
        (timing.tolerance or _TOLERANCE) * size,
        _STALE_RATE,
        timing.steps_per_frame,
        energy=equations.energy if guarded else None,
        energy_tolerance=(timing.energy_tolerance or 0.0) * sum(scene.energy_scale for scene in scenes),
    )
