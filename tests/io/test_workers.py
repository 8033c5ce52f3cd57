"""Calls made in other processes."""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import pytest
import torch

from physconvex import InputError
from physconvex.io import Workers


def place(_number=0):
    return os.getpid(), torch.get_num_threads(), os.environ.get("OMP_NUM_THREADS")


def refused():
    raise InputError("field: none")


def test_one_process_does_everything_itself_and_only_when_asked():
    called = []
    with Workers() as workers:
        wait = workers.start(partial(called.append, 1))
        assert not called
        wait()
        assert called == [1] and workers.map(place, [0, 1]) == [place(), place()] and not workers.running


def test_several_work_elsewhere_with_one_thread_and_raise_what_is_raised_there(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    with Workers(2) as workers:
        found = workers.map(place, range(4))
        assert all(pid != os.getpid() and threads == 1 and omp == "1" for pid, threads, omp in found)
        assert workers.running and os.environ["OMP_NUM_THREADS"] == "2"
        with pytest.raises(InputError, match="field: none"):
            workers.start(refused)()
    assert not workers.running


def test_processes_are_begun_for_as_many_calls_as_come():
    with Workers() as alone, Workers(4) as workers:
        alone.begin(2)
        workers.begin(2)
        assert not alone.running and len(workers._pool._processes) == 2


def test_a_single_item_starts_no_process():
    with Workers(2) as workers:
        assert workers.map(place, [0])[0][0] == os.getpid() and not workers.running


def test_where_processes_die_the_work_is_done_here():
    with Workers(2) as workers:
        workers._pool = ProcessPoolExecutor(1, initializer=os._exit, initargs=(1,))
        with pytest.warns(RuntimeWarning, match="one after the other"):
            found = workers.map(place, range(3))
        assert [pid for pid, *_ in found] == [os.getpid()] * 3 and workers.processes == 1
