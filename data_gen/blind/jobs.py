"""Independent pieces of work on a bank, several at once, told one by one."""

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
    """Call a function of each job, which must be picklable.

    Args:
        function: what is done.
        jobs: with names.
        workers: processes.
        report: told each name, in order, when its job is waited for.
    """
    with Workers(workers) as pool:
        for job, wait in [(job, pool.start(partial(function, job))) for job in jobs]:
            report(job.name)
            wait()
