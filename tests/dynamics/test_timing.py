import dataclasses

import pytest

from physconvex import InputError
from physconvex.dynamics import Timing


def test_each_step_a_frame():
    timing = Timing(frames=5, fps=20.0, steps_per_frame=6, tolerance=1e-6)
    assert timing.every_step() == Timing(frames=25, fps=120.0, steps_per_frame=1, tolerance=1e-6)
    assert timing.every_step(0.06).frames == 37 and timing.every_step(-1.0).frames == 25
    assert timing.steps == 24


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tolerance": 0.0}, "tolerance: got 0.0"),
        ({"energy_tolerance": -1.0}, "energy_tolerance: got -1.0"),
        ({"flight_steps_per_frame": -2}, "expected > 0"),
        pytest.param({"contact_solver": "penalty"}, "contact_solver: got 'penalty'", marks=pytest.mark.wrong_types),
    ],
)
def test_bad_values_are_named(change, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(Timing(), **change)
