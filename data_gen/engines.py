"""Execution of independent tasks: in this process, in local worker processes, or on a ray or dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Annotated, Literal, TypeVar

from pydantic import Field

from physconvex import InputError
from physconvex.io import ONE_THREAD, Options, Workers, end_with_parent, one_thread_each

Task = TypeVar("Task")
Result = TypeVar("Result")


class WorkerOptions(Options):
    """Where tasks run; no result depends on it."""

    workers: Annotated[int, Field(ge=1)] = 2
    """Worker processes."""
    engine: Literal["local", "ray", "dask"] = "local"
    """Engine that runs the workers."""


def run_tasks(
    function: Callable[[Task], Result], tasks: Sequence[Task], options: WorkerOptions | None = None
) -> Iterator[Result]:
    """Apply `function` to all tasks, by default in one process, and yield the results as they finish, in any order.

    Raises:
        InputError: an engine that is not installed.
    """
    options = options or WorkerOptions(workers=1)
    run = {"local": _local, "ray": _ray, "dask": _dask}[options.engine]
    yield from run(function, tasks, options.workers)


def _local(function: Callable[[Task], Result], tasks: Sequence[Task], workers: int) -> Iterator[Result]:
    # Fresh processes: a forked one would inherit OpenGL contexts and thread pools that do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with one_thread_each(), ProcessPoolExecutor(workers, context, end_with_parent) as pool:
        futures = [pool.submit(function, task) for task in tasks]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _ray(function: Callable[[Task], Result], tasks: Sequence[Task], workers: int) -> Iterator[Result]:
    try:
        import ray
    except ImportError as error:
        raise InputError('engine: "ray" is not installed; expected it (pip install "physconvex[ray]")') from error
    if not ray.is_initialized():
        # A running cluster knows its number of processors, and rejects another one.
        local = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": workers, "include_dashboard": False}
        ray.init(log_to_driver=False, **local)
    remote = ray.remote(num_cpus=1, runtime_env={"env_vars": ONE_THREAD})(function)
    waiting = [remote.remote(task) for task in tasks]
    while waiting:
        done, waiting = ray.wait(waiting)
        yield from ray.get(done)


def _dask(function: Callable[[Task], Result], tasks: Sequence[Task], workers: int) -> Iterator[Result]:
    try:
        from distributed import Client, LocalCluster, as_completed
    except ImportError as error:
        raise InputError('engine: "dask" is not installed; expected it (pip install "physconvex[dask]")') from error
    address = os.environ.get("DASK_SCHEDULER_ADDRESS")
    with one_thread_each():
        cluster = None if address else LocalCluster(workers, threads_per_worker=1, dashboard_address=None)
        with Client(address or cluster) as client:
            futures = client.map(function, tasks, pure=False)
            for future in as_completed(futures):
                yield future.result()
        if cluster is not None:
            cluster.close()


def run_jobs(calls: Mapping[str, Callable[[], object]], *, workers: int, report: Callable[[str], None]) -> None:
    """Make calls, which must be picklable.

    Args:
        calls: by name.
        workers: number of processes.
        report: receives each name, in order, when the function waits for its call.
    """
    with Workers(workers) as pool:
        for name, wait in [(name, pool.start(call)) for name, call in calls.items()]:
            report(name)
            wait()
