"""From parameter values to positions of material points: what an identification compares with what was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.fem import simulate as simulate_full
from physconvex.fem.embedding import Embedding
from physconvex.fem.mesh import TetMesh
from physconvex.identify.twin import Twin
from physconvex.reduced import simulate, simulate_with_sensitivities

__all__ = ["FullModel", "Model", "ReducedModel"]


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


@dataclass(frozen=True, eq=False)
class FullModel:
    """The full-order finite elements as a model; it has no derivatives.

    Attributes:
        twin: body and world.
        names: the parameters.
        points: rest positions of the points [m], shape [P, 3].
        frames: number of frames T.
        mesh: another mesh of the same geometry; the twin's own unless given.
        refinement: factor on the number of time steps.
    """

    twin: Twin
    names: tuple[str, ...]
    points: Float[np.ndarray, "P 3"]
    frames: int
    mesh: TetMesh | None = None
    refinement: int = 1

    @cached_property
    def _embedding(self) -> Embedding:
        return Embedding.of_points(self.twin.mesh if self.mesh is None else self.mesh, self.points)

    def node_positions(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T V 3"]:
        """Positions of the nodes of the mesh at the frames [m]."""
        scene = self.twin.with_values(self.names, values).full_scene(self.mesh)
        timing = self.twin.timing(self.frames)
        timing["steps_per_frame"] *= self.refinement
        return simulate_full(scene, **timing).positions

    def positions(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T P 3"]:
        """Positions of the points at the frames [m]."""
        return self._embedding.apply(self.node_positions(values))

    def linearise(
        self, values: Float[np.ndarray, " K"]
    ) -> tuple[Float[np.ndarray, "T P 3"], Float[np.ndarray, "T K P 3"]]:
        """There are none.

        Raises:
            InputError: always; take the derivatives of the reduced model (`correct`).
        """
        raise InputError("FullModel: has no derivatives; fit a ReducedModel and `correct` it with this one")


def check_names(names: Sequence[str], expected: Sequence[str]) -> None:
    """A model and a list of parameters speak of the same unknowns, in one order.

    Raises:
        InputError: they do not.
    """
    if tuple(names) != tuple(expected):
        raise InputError(f"parameters: got {list(expected)}; expected those of the model, {list(names)}")
