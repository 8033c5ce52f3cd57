"""Roll-outs of full models, remembered, and made several at once where processes are allowed for it."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError
from physconvex.fem import Scene
from physconvex.fem import simulate as simulate_full
from physconvex.fem.simulation import ContactSolver
from physconvex.processes import end_with_parent

__all__ = ["RollOut", "RollOuts"]

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


def _rolled_out(job: RollOut) -> Float[np.ndarray, "T V 3"] | ConvergenceError:
    """Positions of the nodes at the frames [m], or why there are none."""
    try:
        return simulate_full(job.scene, **job.timing, contact_solver=job.solver).positions
    except ConvergenceError as error:
        return error


def _from_bytes(job: bytes) -> Float[np.ndarray, "T V 3"] | ConvergenceError:
    """The same in another process; as bytes, since torch would share its tensors' memory with that."""
    return _rolled_out(pickle.loads(job))


class RollOuts:
    """The last roll-outs of full models and their derivatives, so that none is made twice.

    Args:
        most: how many are kept.
        processes: in which those that are wanted together are made; 1: one after the other in this process. Started
            with the first that are worth it; they import the program's main module, as all of Python's do.
    """

    def __init__(self, most: int = 32, processes: int = 1) -> None:
        self.most, self.processes = most, processes
        self._pool: ProcessPoolExecutor | None = None
        self._kept: dict[Hashable, np.ndarray | ConvergenceError] = {}
        self._tangents: dict[Hashable, np.ndarray] = {}

    def __enter__(self) -> RollOuts:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def prepare(self, wanted: Mapping[Hashable, Callable[[], RollOut]]) -> None:
        """Make those that are not kept, several at once where that pays; failures are kept too."""
        missing = {key: make() for key, make in wanted.items() if key not in self._kept}
        for key, result in zip(missing, self._made(list(missing.values())), strict=True):
            self.keep(key, result)

    def _made(self, jobs: Sequence[RollOut]) -> list[np.ndarray | ConvergenceError]:
        if self.processes > 1 and len(jobs) > 1 and max(job.work for job in jobs) > _LIGHT:
            if self._pool is None:
                self._pool = ProcessPoolExecutor(
                    self.processes, mp_context=get_context("spawn"), initializer=end_with_parent
                )
            try:
                return list(self._pool.map(_from_bytes, [pickle.dumps(job) for job in jobs]))
            except BrokenProcessPool:
                warnings.warn("a worker process died: roll-outs are made one after the other", RuntimeWarning, 2)
                self.processes = 1
        return [_rolled_out(job) for job in jobs]

    def positions(self, key: Hashable, make: Callable[[], RollOut]) -> Float[np.ndarray, "T V 3"]:
        """Positions of the nodes [m], made if they are not kept.

        Raises:
            ConvergenceError: the roll-out fails, or has failed.
        """
        if key not in self._kept:
            self.prepare({key: make})
        found = self._kept[key]
        if isinstance(found, ConvergenceError):
            raise found
        return found

    def keep(self, key: Hashable, positions: np.ndarray | ConvergenceError) -> None:
        """Remember positions, or a failure."""
        _put(self._kept, key, positions, self.most)

    def tangents(self, key: Hashable) -> Float[np.ndarray, "T K V 3"] | None:
        """The derivatives that are known there."""
        return self._tangents.get(key)

    def keep_tangents(self, key: Hashable, tangents: Float[np.ndarray, "T K V 3"]) -> None:
        """Remember derivatives."""
        _put(self._tangents, key, tangents, self.most)


def _put(kept: dict[Hashable, Any], key: Hashable, value: Any, most: int) -> None:
    kept.pop(key, None)
    while len(kept) >= most:
        kept.pop(next(iter(kept)))
    kept[key] = value
