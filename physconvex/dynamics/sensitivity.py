"""Roll-outs with the derivatives of their states by parameters, carried along step by step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.integrators import State
from physconvex.dynamics.simulation import Simulated, Trajectory_co, TrajectoryT, simulate
from physconvex.dynamics.stepping import StepRecord
from physconvex.dynamics.timing import Timing
from physconvex.numerics import one_torch_thread


@runtime_checkable
class CarriedTangents(Protocol):
    """Derivatives of the state by P parameters."""

    @property
    def state(self) -> State:
        """The derivatives of positions and velocities, of shape [P, R, 3]."""

    def observe(self, equations: Any, record: StepRecord) -> None:
        """Advance over one converged step."""


@runtime_checkable
class Parametrised(Protocol[Trajectory_co]):
    """A scene and the parameters that it is differentiated by."""

    @property
    def scene(self) -> Simulated[Trajectory_co]:
        """The scene at the values."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the P parameters."""

    @property
    def values(self) -> Float[np.ndarray, " P"]:
        """Values of the parameters."""

    def tangents(self, timing: Timing) -> CarriedTangents:
        """The derivatives at the start of a roll-out.

        Raises:
            InputError: unknown parameters, or a scene or timing without derivatives.
        """


@dataclass(frozen=True, eq=False)
class SensitiveTrajectory(Generic[TrajectoryT]):
    """A roll-out and its derivatives.

    Attributes:
        trajectory: the roll-out.
        parameters: names of the parameters.
        values: their values, shape [P].
        coordinate_tangents: derivatives of the positions of nodes (or of reduced coordinates) at the frames, shape
            [T, P, R, 3].
        velocity_tangents: those of the velocities.
    """

    trajectory: TrajectoryT
    parameters: tuple[str, ...]
    values: Float[np.ndarray, " P"]
    coordinate_tangents: Float[np.ndarray, "T P R 3"]
    velocity_tangents: Float[np.ndarray, "T P R 3"]


@one_torch_thread()
def simulate_with_sensitivities(
    parametrised: Parametrised[TrajectoryT], timing: Timing | None = None
) -> SensitiveTrajectory[TrajectoryT]:
    """Roll a scene out and differentiate its states by parameters.

    The step size is not differentiated: with halved steps, the derivative is that of the halved steps.

    Args:
        parametrised: `physconvex.reduced.NamedParameters` or `physconvex.fem.SceneFamily`.
        timing: as in `simulate`.

    Raises:
        InputError: as `simulate`; a scene or timing without derivatives.
        ConvergenceError: as in `simulate`, or the derivatives of a step do not converge.
    """
    timing = timing or Timing()
    carried = parametrised.tangents(timing)
    states = [carried.state]
    run = simulate(
        parametrised.scene, timing, observer=carried.observe, on_frame=lambda _: states.append(carried.state)
    )
    return SensitiveTrajectory(
        trajectory=run,
        parameters=parametrised.names,
        values=parametrised.values,
        coordinate_tangents=np.stack([state.positions for state in states]),
        velocity_tangents=np.stack([state.velocities for state in states]),
    )
