"""Jobs in several processes: the same results in the same order, errors told, a worker that dies made good."""

import math
import os
import warnings

import numpy as np
import pytest

from physconvex.crew import Crew, cores
from physconvex.errors import ConvergenceError, InputError


def test_results_come_in_the_order_of_the_jobs_from_more_than_one_process():
    with Crew(2) as crew:
        assert crew.run(math.sqrt, [4.0, 9.0, 16.0, 25.0, 36.0]) == [2, 3, 4, 5, 6]
        found = crew.run(os.path.abspath, [".", ".."])
        assert found == [os.path.abspath("."), os.path.abspath("..")]
        worker = crew._workers[0]._process
        assert worker.poll() is None
    assert worker.poll() is not None


def test_arrays_are_the_same_to_the_last_bit():
    matrices = [np.random.default_rng(seed).normal(size=(40, 40)) for seed in range(6)]
    expected = [np.linalg.inv(matrix) for matrix in matrices]
    with Crew(2) as crew:
        for one, other in zip(crew.run(np.linalg.inv, matrices), expected, strict=True):
            np.testing.assert_array_equal(one, other)


def test_one_process_starts_no_other():
    crew = Crew(1)
    assert crew.run(math.sqrt, [4.0, 9.0]) == [2, 3] and not crew._workers
    assert Crew().size == cores() >= 1


def test_errors_of_this_package_are_results_and_all_others_are_raised():
    error = ConvergenceError("no")
    with Crew(2) as crew:
        found = crew.run(_fail, [error, error, None])
        assert [type(one) for one in found] == [ConvergenceError, ConvergenceError, type(None)]
        assert isinstance(crew.run(_fail, [InputError("bad")])[0], InputError)
        with pytest.raises(ZeroDivisionError):
            crew.run(_fail, [ZeroDivisionError(), None])


def _fail(error):
    if error is not None:
        raise error


def test_the_job_of_a_worker_that_dies_is_done_again_here():
    with Crew(2) as crew, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert crew.run(_die_elsewhere, [os.getpid()] * 4) == [os.getpid()] * 4
        assert any("died" in str(one.message) for one in told) and not crew._workers
        assert crew.run(math.sqrt, [4.0, 9.0]) == [2, 3] and not crew._workers


def _die_elsewhere(parent):
    if os.getpid() != parent:
        os._exit(3)
    return parent
