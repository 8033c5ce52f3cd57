"""Memory of the full models' roll-outs; runs several at once if processes are available."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import GuessErrors, Timing, simulate
from physconvex.errors import ConvergenceError
from physconvex.fem import Scene
from physconvex.io import Workers

_KEPT = 32  # roll-outs in the memory
_LIGHT = 1e4  # nodes times time steps: less work than the start of a process


@dataclass(frozen=True, eq=False)
class RollOut:
    """A requested roll-out: the scene, its timing, and a guide."""

    scene: Scene
    timing: Timing
    guess_errors: GuessErrors | None = None

    @property
    def work(self) -> int:
        """Nodes times time steps."""
        return len(self.scene.body.mesh.vertices) * self.timing.frames * self.timing.steps_per_frame


_Made = tuple[np.ndarray, GuessErrors | None] | ConvergenceError


def _rolled_out(job: RollOut) -> _Made:
    """Positions of the nodes at the frames [m], shape [T, V, 3], and a guide, or why there are none."""
    recorded_errors = GuessErrors()
    try:
        run = simulate(job.scene, job.timing, guess_errors=job.guess_errors, recorded_errors=recorded_errors)
    except ConvergenceError as error:
        return error
    return run.positions, recorded_errors


class RollOuts:
    """The last roll-outs of full models and their derivatives, so that none is repeated.

    Args:
        workers: run several roll-outs at once if these are large enough.
    """

    def __init__(self, workers: Workers | None = None) -> None:
        self.workers = workers or Workers()
        self._kept: dict[Hashable, np.ndarray | ConvergenceError] = {}
        self._guess_errors: dict[Hashable, GuessErrors | None] = {}
        self._tangents: dict[Hashable, np.ndarray] = {}

    def prepare(
        self, wanted: Mapping[Hashable, Callable[[], RollOut]], near: Mapping[Hashable, Hashable] = MappingProxyType({})
    ) -> None:
        """Run those that are not kept, several at once if that is faster; failures are kept too.

        Args:
            wanted: the requested roll-outs.
            near: roll-outs similar to another one, which guides them; if that is requested too, it runs first.
        """
        missing = {key: make for key, make in wanted.items() if key not in self._kept}
        later = {key for key in missing if near.get(key, key) != key and near[key] in missing}
        for keys in ([key for key in missing if key not in later], [key for key in missing if key in later]):
            jobs = [replace(missing[key](), guess_errors=self._guess_errors.get(near.get(key))) for key in keys]
            for key, made in zip(keys, self._made(jobs), strict=True):
                positions, guess_errors = (made, None) if isinstance(made, ConvergenceError) else made
                self.keep(key, positions)
                _put(self._guess_errors, key, guess_errors)

    def _made(self, jobs: Sequence[RollOut]) -> list[_Made]:
        if jobs and max(job.work for job in jobs) > _LIGHT:
            return self.workers.map(_rolled_out, jobs)
        return [_rolled_out(job) for job in jobs]

    def positions(self, key: Hashable, make: Callable[[], RollOut]) -> Float[np.ndarray, "T V 3"]:
        """Positions of the nodes [m], computed if they are not kept.

        Raises:
            ConvergenceError: the roll-out fails.
        """
        if key not in self._kept:
            self.prepare({key: make})
        found = self._kept[key]
        if isinstance(found, ConvergenceError):
            raise found
        return found

    def keep(self, key: Hashable, positions: np.ndarray | ConvergenceError) -> None:
        """Remember positions, or a failure."""
        _put(self._kept, key, positions)

    def tangents(self, key: Hashable) -> Float[np.ndarray, "T K V 3"] | None:
        """The stored derivatives."""
        return self._tangents.get(key)

    def keep_tangents(self, key: Hashable, tangents: Float[np.ndarray, "T K V 3"]) -> None:
        """Remember derivatives."""
        _put(self._tangents, key, tangents)


def _put(kept: dict[Hashable, Any], key: Hashable, value: Any) -> None:
    kept.pop(key, None)
    while len(kept) >= _KEPT:
        kept.pop(next(iter(kept)))
    kept[key] = value
