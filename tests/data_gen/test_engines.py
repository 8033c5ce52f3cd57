"""Engines: every task once, and errors that reach the caller (tests of clusters: test_generate.py)."""

import math

import pytest

from data_gen.engines import WorkerOptions, run_tasks


@pytest.mark.slow
def test_local_workers_do_every_task_once():
    assert sorted(run_tasks(math.sqrt, [0, 1, 4, 9], WorkerOptions(workers=2))) == [0, 1, 2, 3]


def test_errors_of_a_task_reach_the_caller():
    with pytest.raises(ValueError, match=r"math domain|nonnegative"):
        list(run_tasks(math.sqrt, [-1.0]))
