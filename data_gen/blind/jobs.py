"""Parallel independent jobs on a bank, with one progress report per job."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Protocol, TypeVar, runtime_checkable

from physconvex.io import Workers


@runtime_checkable
class _Named(Protocol):
    @property
    def name(self) -> str: ...


Job = TypeVar("Job", bound=_Named)


def run_jobs(
    function: Callable[[Job], None], jobs: Iterable[Job], *, workers: int, report: Callable[[str], None]
) -> None:
    """Call a function on each job, which must be picklable.

    Args:
        function: function of one job.
        jobs: jobs with names.
        workers: number of processes.
        report: receives each name, in order, when the function waits for its job.
    """
    with Workers(workers) as pool:
        for job, wait in [(job, pool.start(partial(function, job))) for job in jobs]:
            report(job.name)
            wait()
