"""Roll-outs of full models, remembered, and made several at once where there are cores for it."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from physconvex.crew import Crew
from physconvex.errors import ConvergenceError, PhysconvexError
from physconvex.fem import Scene
from physconvex.fem import simulate as simulate_full
from physconvex.fem.simulation import ContactSolver

__all__ = ["RollOut", "RollOuts", "Tangents"]

_LIGHT = 1e4  # nodes times time steps: less work than to start a process


@dataclass(frozen=True, eq=False)
class RollOut:
    """One that is asked for: the scene, arguments of `physconvex.fem.simulate`, how contact is solved for."""

    scene: Scene
    timing: Mapping[str, Any]
    solver: ContactSolver

    @property
    def work(self) -> int:
        """Nodes times time steps."""
        return len(self.scene.body.mesh.vertices) * self.timing["frames"] * self.timing["steps_per_frame"]


def rolled_out(job: RollOut) -> Float[np.ndarray, "T V 3"]:
    """Positions of the nodes at the frames [m]."""
    return simulate_full(job.scene, **job.timing, contact_solver=job.solver).positions


@dataclass(frozen=True, eq=False)
class Tangents:
    """Derivatives of the nodes' positions, shape [T, K, V, 3]; fresh, or carried on by Broyden's update."""

    values: Float[np.ndarray, "T K V 3"]
    fresh: bool


class RollOuts:
    """The last roll-outs of full models and their derivatives, so that none is made twice.

    Args:
        most: how many are kept.
        crew: makes several at once; None: one after the other.
    """

    def __init__(self, most: int = 32, crew: Crew | None = None) -> None:
        self.most, self.crew = most, Crew(1) if crew is None else crew
        self._kept: dict[Hashable, np.ndarray | PhysconvexError] = {}
        self._tangents: dict[Hashable, Tangents] = {}

    def prepare(self, wanted: Mapping[Hashable, Callable[[], RollOut]]) -> None:
        """Make those that are not kept, several at once where that pays; failures are kept too."""
        missing = {key: make() for key, make in wanted.items() if key not in self._kept}
        jobs = list(missing.values())
        results = self.crew.run(rolled_out, jobs, at_once=max((job.work for job in jobs), default=0) > _LIGHT)
        for key, result in zip(missing, results, strict=True):
            self.keep(key, result)

    def positions(self, key: Hashable, make: Callable[[], RollOut]) -> Float[np.ndarray, "T V 3"]:
        """Positions of the nodes [m], made if they are not kept.

        Raises:
            ConvergenceError: the roll-out fails, or has failed.
        """
        if key not in self._kept:
            self.prepare({key: make})
        found = self._kept[key]
        if isinstance(found, PhysconvexError):
            raise found
        return found

    def keep(self, key: Hashable, positions: np.ndarray | PhysconvexError) -> None:
        """Remember positions, or a failure."""
        if isinstance(positions, PhysconvexError) and not isinstance(positions, ConvergenceError):
            raise positions
        _put(self._kept, key, positions, self.most)

    def tangents(self, key: Hashable) -> Tangents | None:
        """The derivatives that are known there."""
        return self._tangents.get(key)

    def keep_tangents(self, key: Hashable, tangents: Tangents) -> None:
        """Remember derivatives."""
        _put(self._tangents, key, tangents, self.most)


def _put(kept: dict[Hashable, Any], key: Hashable, value: Any, most: int) -> None:
    kept.pop(key, None)
    while len(kept) >= most:
        kept.pop(next(iter(kept)))
    kept[key] = value
