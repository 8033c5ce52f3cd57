"""What effects gain before the first contact."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, ErrorModel
from physconvex.gap.base.baseline import Split
from physconvex.gap.base.body_modes import BodyModes
from physconvex.gap.judgement.residual_measures import gain_in_flight, left_in_flight

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits

FRAMES, ROWS, TOUCHED = 12, 60, 8
WIND = next(e for e in DEFAULT_EFFECTS if e.name == "wind")


def case(touched=TOUCHED):
    """A base fit of one kind of residual before the first contact, and one from then on."""
    frames = np.repeat(np.arange(FRAMES), ROWS)
    modes = BodyModes(frames, np.where(frames < touched, 0, 3), (6.0, 6.0, 12.0) * 2)
    base = SimpleNamespace(
        split=Split(np.arange(FRAMES), np.arange(0), np.arange(0)),
        observations=SimpleNamespace(frames=frames),
        modes=modes,
        model=SimpleNamespace(frames=FRAMES),
        rows=lambda chosen: np.flatnonzero(np.isin(frames, chosen)),
        residual=lambda positions: positions,
    )
    return base, ErrorModel(np.ones(len(frames)), np.zeros((0, len(frames))), np.ones(len(frames)))


def fits(base, before, after, gain):
    """One that leaves so much before and after the first contact, and the base model; the flight gains so much."""
    left = np.where(base.modes.kinds == 0, before, after)
    likelihood = np.array([gain, 0, 0, -300.0, 0, 0])  # worse than the base model after the impact
    best = SimpleNamespace(effects=(WIND,), positions=left, likelihood=likelihood, divisor=np.full(6, 2.0))
    return best, SimpleNamespace(likelihood=np.zeros(6))


def test_a_gain_in_flight_counts_whatever_follows_the_impact():
    base, errors = case()
    found = gain_in_flight(base, errors, *fits(base, 1.0, 30.0, 80.0))
    # tempered by two; two doses, told by half of the numbers in flight
    assert found == pytest.approx(40.0 - 0.5 * 2 * np.log((TOUCHED * (ROWS + 1.5)) / 2), rel=0.02)


def test_the_frame_next_to_the_contact_is_no_flight_to_be_followed():
    """A cube of another program touched its floor a frame before the model's did, and its spin was not named."""
    base, errors = case()
    best, plain = fits(base, 1.0, 30.0, 80.0)
    best.positions = np.where(base.observations.frames == TOUCHED - 1, 50.0, best.positions)
    assert gain_in_flight(base, errors, best, plain) > 30.0
    best.positions = np.where(base.observations.frames == TOUCHED - 2, 50.0, best.positions)
    assert gain_in_flight(base, errors, best, plain) == -np.inf
    at_once, errors = case(1)  # it has no other frame of flight
    assert gain_in_flight(at_once, errors, *fits(at_once, 1.0, 30.0, 80.0)) == -np.inf


@pytest.mark.parametrize(("before", "touched"), [(2.0, TOUCHED), (1.0, FRAMES)])
def test_none_where_the_flight_is_not_followed_or_nothing_follows_it(before, touched):
    base, errors = case(touched)
    assert gain_in_flight(base, errors, *fits(base, before, 1.0, 80.0)) == -np.inf


def test_what_each_fit_leaves_of_the_flight():
    base, errors = case()
    frames = base.observations.frames

    def fit(flight, last, after):
        left = np.where(frames < TOUCHED - 1, flight, np.where(frames < TOUCHED, last, after))
        return SimpleNamespace(positions=left)

    fits = [fit(5.0, 0.0, 1.0), fit(3.0, 50.0, 90.0)]  # the frame before the contact does not count, nor what follows
    assert left_in_flight(base, errors, fits) == 0.0  # of a video, whose residuals are not divided
    base.modes = replace(base.modes, reflections=((slice(0, ROWS), None, None),))
    assert left_in_flight(base, errors, fits) == pytest.approx(9.0)
    struck, _ = case(0)
    struck.modes = replace(struck.modes, reflections=base.modes.reflections)
    assert left_in_flight(struck, errors, fits) == 0.0
