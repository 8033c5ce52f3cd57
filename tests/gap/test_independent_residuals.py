"""Residuals that are alike count as one."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, ErrorModel, Hypothesis
from physconvex.gap.base.body_modes import temperature
from physconvex.gap.errors.error_model import detail_errors
from physconvex.gap.search.hypothesis import evidence_of_anything

FRAMES, COLUMNS = 40, 9


def judged(table):
    frames, columns = np.indices(table.shape)
    return temperature(table.ravel(), frames.ravel(), columns.ravel())


def test_noise_is_not_tempered(rng):
    assert judged(rng.normal(size=(FRAMES, COLUMNS))) < 2.0


def test_large_white_residuals_are_hardly_tempered(rng):
    assert judged(10 * rng.normal(size=(FRAMES, COLUMNS))) < 2.0


def test_one_smooth_shape_counts_as_a_few_moments(rng):
    shape, wave = rng.normal(size=COLUMNS), np.sin(np.arange(FRAMES) / 5)
    left = 20 * np.outer(wave, shape) + rng.normal(size=(FRAMES, COLUMNS))
    independent = FRAMES * COLUMNS / judged(left)
    assert FRAMES / 3 <= independent < FRAMES / 2  # a sine of 1.3 periods, in one shape


def test_half_noise_half_lack_of_fit_is_tempered_by_half(rng):
    wave = np.sin(np.arange(FRAMES) / 5)[:, None] * np.ones(COLUMNS)
    strong, weak = (judged(s * wave + 0.01 * rng.normal(size=wave.shape)) for s in (1e3, np.sqrt(2 / (wave**2).mean())))
    assert weak == pytest.approx(1 + (strong - 1) / 2, rel=0.02)


@pytest.mark.wrong_types
def test_details_do_not_choose(rng):
    residual = 50 * rng.normal(size=300)
    base = SimpleNamespace(
        situation=SimpleNamespace(clamped=True),
        split=SimpleNamespace(fitted=None),
        rows=lambda frames: np.arange(200),
        residual=lambda positions: residual,
        positions=None,
    )
    errors = ErrorModel(np.full(300, 4.0), np.zeros((0, 300)), np.full(300, 2.0))
    wider = detail_errors(base, errors, 0.1)
    assert wider.variance == pytest.approx(4 + 25, rel=0.2) and wider.expected == pytest.approx(2 + 25, rel=0.2)
    base.situation.clamped = False
    assert detail_errors(base, errors, 0.1) is errors


def fit(likelihood, dose, name="wind"):
    effect = next(e for e in DEFAULT_EFFECTS if e.name == name)
    values = np.array([5.0, dose, *np.zeros(len(effect.doses) - 1)])
    return Hypothesis(
        (effect,),
        None,
        values,
        None,
        None,
        None,
        None,
        5.0,
        5.0,
        0.0,
        np.array([likelihood]),
        np.array([-200.0]),
        np.array([400.0]),
    )


@pytest.mark.wrong_types
def test_tempering_leaves_prices_and_priors():
    storm, breeze = fit(-300.0, 30.0), fit(-310.0, 3.0)
    assert storm.tempered(1.0).evidence > breeze.tempered(1.0).evidence - 10
    assert breeze.tempered(20.0).evidence > storm.tempered(20.0).evidence + 15  # 30 m/s is six times what is plausible
    assert breeze.tempered(20.0).evidence == pytest.approx(-310 / 20 - 0.5 * 2 * np.log(20) - 0.5 * 0.6**2)


@pytest.mark.wrong_types
def test_something_else_is_likely_where_much_is_left():
    poor, good = fit(-1000.0, 0.0).tempered(20.0), fit(-205.0, 0.0).tempered(1.0)
    assert evidence_of_anything(poor) > poor.evidence
    assert evidence_of_anything(good) < good.evidence - 4
