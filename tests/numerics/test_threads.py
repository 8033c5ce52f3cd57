"""Roll-outs use one thread of torch and leave the number as it was; the commands, one of numpy's BLAS."""

import os

import pytest
import torch

from physconvex import InputError, cli, fem, mesh
from physconvex.dynamics import Timing, simulate
from physconvex.numerics import one_torch_thread


@pytest.fixture(autouse=True)
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_the_number_comes_back_after_an_error():
    with pytest.raises(ValueError, match="inside"), one_torch_thread():
        assert torch.get_num_threads() == 1
        raise ValueError("inside")
    assert torch.get_num_threads() == 2


def test_a_roll_out_uses_one():
    seen = []
    scene = fem.Scene(fem.ElasticBody(mesh.box_mesh((0.1, 0.1, 0.1), (1, 1, 1), order=1)))
    simulate(scene, Timing(frames=2, steps_per_frame=1), on_frame=lambda state: seen.append(torch.get_num_threads()))
    assert seen == [1] and torch.get_num_threads() == 2


def test_wrong_arguments_leave_it_too():
    scene = fem.Scene(fem.ElasticBody(mesh.box_mesh((0.1, 0.1, 0.1), (1, 1, 1), order=1)))
    with pytest.raises(InputError):
        simulate(scene, Timing(energy_tolerance=1e-3))
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("4", "4")])
def test_commands_set_numpy_s_threads_unless_they_are_given(monkeypatch, given, expected):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    with pytest.raises(SystemExit):
        cli.main(["--version"])
    assert os.environ["OPENBLAS_NUM_THREADS"] == expected
