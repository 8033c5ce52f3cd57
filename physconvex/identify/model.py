"""From parameter values to positions of material points: what an identification compares with what was seen."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.fem import Scene
from physconvex.fem import simulate as simulate_full
from physconvex.fem import simulate_with_sensitivities as full_with_sensitivities
from physconvex.fem.carried_contact import SurfacePoints
from physconvex.fem.embedding import Embedding
from physconvex.fem.mesh import TetMesh
from physconvex.fem.sensitivity import SensitiveTrajectory
from physconvex.identify.parameters import default_parameter, lower_bounds, step_scales, upper_bounds
from physconvex.identify.twin import Twin
from physconvex.reduced import simulate, simulate_with_sensitivities

__all__ = ["FullModel", "LinearModel", "Model", "ReducedModel", "RollOuts"]

PASSES = 12  # most linearisations of friction in each step of a full model
_DIFFERENCE = 1e-6  # of a typical step: half width of the central differences; contact is linear over microns only
_ROUGH_DIFFERENCE = 0.1  # of a typical step: where friction makes a roll-out rough at smaller scales


@runtime_checkable
class Model(Protocol):
    """Positions of chosen points in all frames, by named parameters."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the K parameters."""

    def positions(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T P 3"]:
        """Positions of the points at the frames [m]."""

    def linearise(
        self, values: Float[np.ndarray, " K"]
    ) -> tuple[Float[np.ndarray, "T P 3"], Float[np.ndarray, "T K P 3"]]:
        """Positions and their derivatives by the parameters."""


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """The reduced simulator as a model.

    Attributes:
        twin: body and world.
        names: the parameters.
        points: rest positions of the points [m], shape [P, 3].
        frames: number of frames T, the first at t = 0.
        options: further arguments of `physconvex.reduced.simulate`.
    """

    twin: Twin
    names: tuple[str, ...]
    points: Float[np.ndarray, "P 3"]
    frames: int
    options: tuple[tuple[str, Any], ...] = ()

    @cached_property
    def _shapes(self) -> np.ndarray:
        return self.twin.scene.body.space.shape_values(self.points)

    def _arguments(self) -> dict[str, Any]:
        return self.twin.timing(self.frames) | dict(self.options)

    def positions(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T P 3"]:
        """Positions of the points at the frames [m]."""
        run = simulate(self.twin.with_values(self.names, values).scene, **self._arguments())
        return self._shapes @ run.coordinates

    def linearise(
        self, values: Float[np.ndarray, " K"]
    ) -> tuple[Float[np.ndarray, "T P 3"], Float[np.ndarray, "T K P 3"]]:
        """Positions and their derivatives, by the implicit function theorem (`simulate_with_sensitivities`)."""
        scene = self.twin.with_values(self.names, values).scene
        run = simulate_with_sensitivities(scene, self.names, **self._arguments())
        return self._shapes @ run.trajectory.coordinates, self._shapes @ run.coordinate_tangents


class RollOuts:
    """The last roll-outs of full models, so that a fit which begins where another one has ended need not make it again.

    Args:
        most: how many are kept.
    """

    def __init__(self, most: int = 6) -> None:
        self.most = most
        self._kept: dict[Hashable, SensitiveTrajectory] = {}

    def find(self, key: Hashable) -> SensitiveTrajectory | None:
        """A linearised roll-out that is kept."""
        return self._kept.get(key)

    def get(self, key: Hashable, compute: Callable[[], SensitiveTrajectory]) -> SensitiveTrajectory:
        """The same, made and kept if it is not there."""
        if key not in self._kept:
            made = compute()
            while len(self._kept) >= self.most:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = made
        return self._kept[key]


@dataclass(frozen=True, eq=False)
class FullModel:
    """The full-order finite elements as a model.

    Attributes:
        twin: body and world.
        names: the parameters.
        points: rest positions of the points [m], shape [P, 3].
        frames: number of frames T.
        mesh: another mesh of the same geometry; the twin's own unless given.
        refinement: factor on the number of time steps.
        friction_passes: most linearisations of friction in each step, see `physconvex.fem.simulate`.
        surface: points at which obstacles act, in the place of the boundary's nodes.
        memory: of the last linearised roll-outs; may be shared among models.
    """

    twin: Twin
    names: tuple[str, ...]
    points: Float[np.ndarray, "P 3"]
    frames: int
    mesh: TetMesh | None = None
    refinement: int = 1
    friction_passes: int = PASSES
    surface: SurfacePoints | None = None
    memory: RollOuts = field(default_factory=RollOuts)

    @cached_property
    def _embedding(self) -> Embedding:
        return Embedding.of_points(self.twin.mesh if self.mesh is None else self.mesh, self.points)

    def node_positions(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T V 3"]:
        """Positions of the nodes of the mesh at the frames [m]."""
        kept = self.memory.find(self._key(values))
        run = simulate_full(self.scene(values), **self._timing()) if kept is None else kept.trajectory
        return run.positions

    def scene(self, values: Float[np.ndarray, " K"]) -> Scene:
        """The scene with the parameters set."""
        scene = self.twin.with_values(self.names, values).full_scene(self.mesh)
        return scene if self.surface is None else replace(scene, contact_points=self.surface)

    def _timing(self) -> dict[str, Any]:
        timing = self.twin.timing(self.frames)
        steps = timing["steps_per_frame"] * self.refinement
        return timing | {"steps_per_frame": steps, "friction_passes": self.friction_passes}

    def _key(self, values: np.ndarray) -> Hashable:
        grid = id(self.twin.mesh if self.mesh is None else self.mesh)
        how = (self.refinement, self.friction_passes, self.frames, id(self.surface))
        return (self.twin, grid, self.names, *how, np.asarray(values, dtype=np.float64).tobytes())

    def positions(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T P 3"]:
        """Positions of the points at the frames [m]."""
        return self._embedding.apply(self.node_positions(values))

    def linearise(
        self, values: Float[np.ndarray, " K"]
    ) -> tuple[Float[np.ndarray, "T P 3"], Float[np.ndarray, "T K P 3"]]:
        """Positions and their derivatives (`physconvex.fem.simulate_with_sensitivities`).

        On a rough floor points stick and slip one after the other, so that a roll-out has corners everywhere, and its
        derivative at a point may be ten times the slope over any change that matters: differences over a tenth of a
        typical step are taken there.
        """
        run = self.memory.get(self._key(values), lambda: self._linearised(values))
        return self._embedding.apply(run.trajectory.positions), self._embedding.apply(run.position_tangents)

    def _linearised(self, values: np.ndarray) -> SensitiveTrajectory:
        usual = [default_parameter(name) for name in self.names]
        steps, lower, upper = step_scales(usual), lower_bounds(usual), upper_bounds(usual)
        if any(obstacle.friction for obstacle in self.twin.with_values(self.names, values).scene.obstacles):
            return self._differenced(values, _ROUGH_DIFFERENCE * steps, lower, upper)
        return full_with_sensitivities(
            self.scene, values, steps=_DIFFERENCE * steps, lower=lower, upper=upper, **self._timing()
        )

    def _differenced(
        self, values: np.ndarray, steps: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> SensitiveTrajectory:
        """Differences of whole roll-outs, upwards unless a bound or a failure is in the way."""
        base = simulate_full(self.scene(values), **self._timing())
        tangents = []
        for place, step in enumerate(steps):
            change = np.zeros(len(values))
            change[place] = step if values[place] + step <= upper[place] else -step
            try:
                moved = simulate_full(self.scene(values + change), **self._timing())
            except ConvergenceError:
                change = -change
                if values[place] + change[place] < lower[place]:
                    raise
                moved = simulate_full(self.scene(values + change), **self._timing())
            tangents.append((moved.positions - base.positions) / change[place])
        return SensitiveTrajectory(base, np.stack(tangents, axis=1))


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Positions and tangents known at one place, straight on from there.

    Attributes:
        names: the parameters.
        anchor: values at that place, shape [K].
        at: positions there [m], shape [T, P, 3].
        tangents: their derivatives there, shape [T, K, P, 3].
    """

    names: tuple[str, ...]
    anchor: Float[np.ndarray, " K"]
    at: Float[np.ndarray, "T P 3"]
    tangents: Float[np.ndarray, "T K P 3"]

    def positions(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T P 3"]:
        """Positions of the points at the frames [m]."""
        return self.at + np.einsum("tkpi,k->tpi", self.tangents, values - self.anchor)

    def linearise(
        self, values: Float[np.ndarray, " K"]
    ) -> tuple[Float[np.ndarray, "T P 3"], Float[np.ndarray, "T K P 3"]]:
        """Positions and the derivatives."""
        return self.positions(values), self.tangents


def check_names(names: Sequence[str], expected: Sequence[str]) -> None:
    """A model and a list of parameters speak of the same unknowns, in one order.

    Raises:
        InputError: they do not.
    """
    if tuple(names) != tuple(expected):
        raise InputError(f"parameters: got {list(expected)}; expected those of the model, {list(names)}")
