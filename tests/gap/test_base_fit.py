"""Which of two starts the base fit goes on from."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex import ConvergenceError
from physconvex.gap.base import base_fit

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits

NAMES = ("log10_youngs_modulus", "poisson_ratio")


class Twin:
    def with_values(self, names, values):
        return SimpleNamespace(values=values)


def fitted(values, misfit):
    model = SimpleNamespace(base=NAMES, twin=Twin(), cost=SimpleNamespace(over=False))
    return SimpleNamespace(
        model=model, fit=base_fit_values(values), situation=SimpleNamespace(clamped=False), misfit=misfit,
        capture=None, observations=None, split=None,
    )  # fmt: skip


def base_fit_values(values):
    from physconvex.identify import Fit

    empty = np.zeros(0)
    made = {name: empty for name in Fit.__dataclass_fields__}
    return Fit(**(made | {"values": np.array(values)}))


@pytest.fixture
def starts(monkeypatch):
    """Fits by the ν that they begin at: from .49 one that ends there, from .31 another."""
    asked = []

    def run_again(rough, found):
        return fitted(found.values, None)

    def fit_from(rough, *rest, **named):
        asked.append(float(rough.fit.values[1]))
        return ends[asked[-1]]

    ends = {}
    monkeypatch.setattr(base_fit, "run_again", run_again)
    monkeypatch.setattr(base_fit, "_fit_from", fit_from)
    monkeypatch.setattr(base_fit, "misfit_of_base", lambda base, variance: base.misfit)
    return asked, ends


@pytest.mark.parametrize(("other", "taken"), [(0.535, 0.373), (0.7, 0.49)])
def test_an_extreme_ratio_is_doubted(starts, other, taken):
    """Fibres along a diagonal: misfit .617 at ν = .49, .535 at .373; no dose of theirs was found from the former."""
    asked, ends = starts
    ends |= {0.491: fitted([4.729, 0.49], 0.617), 0.31: fitted([4.775, 0.373], other)}
    found = base_fit.fit_baseline(fitted([4.637, 0.491], None), None, None, None, options=None, report=None)
    assert found.fit.values[1] == taken and asked == [0.491, pytest.approx(0.31)]


def test_a_usual_ratio_is_not(starts):
    asked, ends = starts
    ends |= {0.4: fitted([4.8, 0.41], 0.6)}
    assert base_fit.fit_baseline(fitted([4.6, 0.4], None), None, None, None, options=None, report=None).misfit == 0.6
    assert len(asked) == 1


def test_a_start_that_cannot_be_simulated_is_left(starts, monkeypatch):
    asked, ends = starts
    ends |= {0.491: fitted([4.729, 0.49], 0.617)}

    def fails(*a, **k):
        raise ConvergenceError("no")

    monkeypatch.setattr(base_fit, "run_again", fails)
    found = base_fit.fit_baseline(fitted([4.637, 0.491], None), None, None, None, options=None, report=None)
    assert found.misfit == 0.617 and len(asked) == 1
