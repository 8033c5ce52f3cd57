"""Coordinates of the search: straight along the valley of E and ν, exact at bounds; steps that fail are halved."""

import numpy as np
import pytest

from physconvex.identify import FitOptions, MarkerObservations, Parameter, fit
from physconvex.identify.parameters import SearchCoordinates

NAMES = ("log10_youngs_modulus", "poisson_ratio", "damping_time")
UNKNOWN = (
    Parameter("log10_youngs_modulus", 5.5, 3.0, 8.0, 0.2),
    Parameter("poisson_ratio", 0.05, 0.0, 0.495, 0.1),
)


def test_they_lead_back_to_the_values():
    coordinates, values = SearchCoordinates(NAMES), np.array([5.2, 0.47, 2e-3])
    there = coordinates.of(values)
    np.testing.assert_array_equal(there[[0, 2]], values[[0, 2]])
    np.testing.assert_allclose(coordinates.values(there), values, rtol=1e-14)
    np.testing.assert_array_equal(coordinates.values(coordinates.of(np.zeros(3))), np.zeros(3))


@pytest.mark.parametrize("ratio", [0.0, 0.35, 0.49])
def test_slopes_against_differences(ratio):
    coordinates, values = SearchCoordinates(NAMES), np.array([5.2, ratio, 2e-3])
    place, step = coordinates.of(values), 1e-6 * np.array([0.0, 1.0, 0.0])
    slope = (coordinates.values(place + step) - coordinates.values(place - step))[1] / 2e-6
    assert coordinates.slopes(values)[1] == pytest.approx(slope, rel=1e-6)
    assert coordinates.slopes(np.array([5.2, 0.35, 2e-3])) == pytest.approx([1.0, 1.0, 1.0])


class Valley:
    """What is well seen is log E + 0.05 log(1 − 2ν) alone; what is left tells ν through log(1 − 2ν) too."""

    names = NAMES[:2]
    well, little = np.random.default_rng(0).normal(size=(2, 3, 5, 3))

    def positions(self, values):
        bulk = np.log(1 - 2 * values[1])
        return self.well * (values[0] + 0.05 * bulk) + 0.003 * self.little * bulk

    def linearise(self, values):
        rise = -2 / (1 - 2 * values[1])
        by_ratio = 0.05 * rise * self.well + 0.003 * rise * self.little
        return self.positions(values), np.stack([self.well, by_ratio], axis=1)


def evaluations_in_the_valley(truth):
    seen = MarkerObservations(np.zeros((5, 3)), Valley().positions(np.array(truth)), np.full((3, 5), 1e-4))
    found = fit(Valley(), seen, UNKNOWN, options=FitOptions(max_iterations=60, max_step=1.5))
    np.testing.assert_allclose(found.values, truth, atol=1e-3)
    return found.evaluations


def test_the_valley_is_straight_in_them(monkeypatch):
    straight = evaluations_in_the_valley((5.4, 0.485))
    monkeypatch.setattr("physconvex.identify.levenberg_marquardt.SearchCoordinates", lambda names: Plain())
    assert straight < 9 < evaluations_in_the_valley((5.4, 0.485))


class Plain(SearchCoordinates):
    """Values as they are."""

    def __init__(self):
        super().__init__(())
        self._bent = np.zeros(2, dtype=bool)


class Wall:
    """Linear in ν up to .2, beyond which everything flies off."""

    names = ("poisson_ratio",)
    direction = np.random.default_rng(1).normal(size=(3, 5, 3))

    def positions(self, values):
        return self.direction * (values[0] + 100 * max(values[0] - 0.2, 0.0))

    def linearise(self, values):
        return self.positions(values), (self.direction * (1.0 if values[0] <= 0.2 else 101.0))[:, None]


def test_a_step_that_fails_is_halved():
    seen = MarkerObservations(np.zeros((5, 3)), 0.19 * Wall.direction, np.full((3, 5), 1e-3))
    pushed = MarkerObservations(np.zeros((5, 3)), 0.5 * Wall.direction, np.full((3, 5), 1e-3))
    start = (Parameter("poisson_ratio", 0.05, 0.0, 0.495, 0.1),)
    for observations, expected in ((seen, 0.19), (pushed, 0.203)):
        found = fit(Wall(), observations, start, options=FitOptions(max_iterations=14))
        assert found.values[0] == pytest.approx(expected, abs=2e-3)


def test_a_bound_is_met_exactly():
    line = np.random.default_rng(2).normal(size=(3, 5, 3))

    class Line:
        names = ("poisson_ratio",)

        def positions(self, values):
            return line * values[0]

        def linearise(self, values):
            return self.positions(values), line[:, None]

    for target, bound in ((-0.3, 0.0), (0.7, 0.495)):
        seen = MarkerObservations(np.zeros((5, 3)), target * line, np.full((3, 5), 1e-3))
        assert fit(Line(), seen, UNKNOWN[1:]).values[0] == bound
