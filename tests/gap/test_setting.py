"""Where a model of the recording's setting cannot be simulated, the diagnosis goes on without it."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex import ConvergenceError
from physconvex.gap import GapOptions, Situation, diagnose, find_setting
from physconvex.gap.conditions import setting


def silent(text):
    """No progress."""


def failing(*arguments, **options):
    """A model that cannot be simulated."""
    raise ConvergenceError("no")


def base_that(**situation):
    """As much of a rough base fit as the questions look at first."""
    return SimpleNamespace(situation=SimpleNamespace(**situation))


@pytest.mark.parametrize("situation", [{"clamped": True, "touches": True}, {"clamped": False, "touches": False}])
def test_nothing_is_asked_of_held_bodies_and_of_those_that_strike_nothing(situation, monkeypatch):
    monkeypatch.setattr(setting, "mesh_of_capture_elements", failing)
    base = base_that(**situation)
    found = find_setting(base, GapOptions(), silent)
    assert found.base is base and found.own is None and found.damped is None


def test_a_setting_that_cannot_be_simulated_leaves_the_base_fit_as_it_is(monkeypatch):
    monkeypatch.setattr(setting, "mesh_of_capture_elements", lambda base: None)
    monkeypatch.setattr(setting, "sinks_in", lambda base: False)
    monkeypatch.setattr(setting, "damped_fit", lambda base, options: (None, None))
    monkeypatch.setattr(setting, "_moved", failing)
    base = base_that(clamped=False, touches=True)
    base.model = SimpleNamespace(base=())
    found = find_setting(base, GapOptions(), silent)
    assert found.base is base and found.damped is None


def test_a_base_model_that_fails_on_the_finer_mesh_is_fitted_without_it(monkeypatch):
    import importlib

    module = importlib.import_module(diagnose.__module__)
    monkeypatch.setattr(module, "replace", lambda model, mesh: SimpleNamespace(motion=failing))
    rough = SimpleNamespace(model=None, fit=SimpleNamespace(values=np.zeros(2)))
    assert module._motion_on_fine_mesh(rough, SimpleNamespace(fine=None)) is None
    assert module._motion_on_fine_mesh(rough, SimpleNamespace(fine=("mesh", "motion"))) is None


@pytest.mark.parametrize(("refuted", "left", "chosen"), [
    (False, {(False, False): 1.0, (False, True): 0.8, (True, True): 0.6}, (False, False)),
    (False, {(False, False): 1.0, (False, True): 0.6, (True, True): 0.6}, (False, True)),
    (True, {(False, False): 1.0, (False, True): 1.2, (True, False): 0.4, (True, True): 1.0}, (False, True)),
    (True, {(False, False): 1.0, (False, True): 1.2, (True, True): 0.8}, (True, True)),
    (True, {(False, False): 1.0, (True, False): 0.4}, (True, False)),
])  # fmt: skip
def test_a_hard_floor_is_refuted_by_how_deep_markers_lie_in_it(refuted, left, chosen):
    """MuJoCo's thrown cube: as well off on a hard floor, with friction, at a third of its E."""
    assert setting._likeliest(left, refuted=refuted) == chosen


def test_markers_lie_in_a_soft_floor_from_two_percent_of_the_size_on():
    above, below = (Situation(0.1, 4e4, 1000.0, 60.0, 10, floor=True, depth=d) for d in (1.9e-3, 2.1e-3))
    assert not above.in_soft_floor and below.in_soft_floor
