"""A fit ends where the recording says, wherever it begins."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, GapOptions, error_model, rough_baseline
from physconvex.gap.base.cost import Cost
from physconvex.gap.base.model import EffectModel
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.search import effect_fits as fitting
from physconvex.gap.search.effect_fits import refit
from physconvex.io import Capture

OPTIONS = GapOptions(max_nodes=100, weights=4)
RATIO = 0.3


@pytest.mark.slow
@pytest.mark.parametrize("off", [-0.1, 0.1])
def test_a_far_start_does_not_decide_where_a_fit_ends(
    released: Callable[[Path, float], Capture], tmp_path: Path, off: float
) -> None:
    """Priors weighed by what the start left, hundreds of times what the end leaves, held ν, and E with it."""
    rough = rough_baseline(released(tmp_path, RATIO), OPTIONS, lambda text: None)
    still = np.zeros_like(rough.motion.positions)
    errors = error_model(rough, Numerics(still, still, still, still, still), OPTIONS)
    load = next(effect for effect in DEFAULT_EFFECTS if effect.label == "attached_mass (-x)")
    model = replace(rough.model, effects=(load,), reduced=False)
    start = np.array([*rough.fit.values, RATIO, 0.0])
    start[0] = np.log10(2e5) + off
    motion = model.motion(start)
    found = refit(rough, errors, model, start, model.linearise(start, motion)[1], options=OPTIONS)
    assert found.fitted < 10 and found.selecting < 10  # 60 and 20 before; what is left is the coarse mesh
    assert found.values[:3] == pytest.approx([5.34, 0.34, 0.376], abs=0.01)  # from either start


@dataclass(frozen=True)
class Model:
    """As much of a model of a struck body as a fit needs; `taken` gathers where derivatives were taken."""

    effects: tuple
    taken: list
    frames: int = 3
    doubt: float = 1.0

    def positions(self, values):
        return np.full((self.frames, 1, 3), values[0])

    motion = positions
    cost = Cost()
    secant = EffectModel.secant

    @property
    def slices(self):
        return [slice(1, 1 + len(self.effects[0].doses))]

    def observed(self, motion, values):
        return motion

    def parameters(self, values):
        return [SimpleNamespace(step=1.0)] * len(values)

    def linearise(self, values, motion=None):
        self.taken.append(float(values[0]))
        return self.positions(values), np.ones((self.frames, len(values), 1, 3))


def base_of_three_frames(*, clamped: bool) -> SimpleNamespace:
    """As much of a base fit as a fit of `Model` needs."""
    return SimpleNamespace(
        fit=SimpleNamespace(values=np.zeros(1)), split=SimpleNamespace(end=3, fitted=np.arange(3)),
        situation=SimpleNamespace(clamped=clamped), weighted=lambda variance, count: None,
        model=SimpleNamespace(cost=Cost()),
    )  # fmt: skip


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("label", "misfits", "taken"),
    [
        ("anisotropy (z)", (9.0, 5.0, 4.0), [1.0, 2.0]),  # as long as that gains, at most twice
        ("anisotropy (z)", (9.0, 8.9, 0.0), [1.0]),
        ("damping", (9.0, 5.0, 4.0), []),  # begins with a dose, and lies nowhere
    ],
)
def test_derivatives_by_a_direction_are_taken_anew(
    monkeypatch: pytest.MonkeyPatch, label: str, misfits: tuple[float, ...], taken: list[float]
) -> None:
    """Taken where there was hardly any fibre, they say nothing of where it points (2501/024, a dropped body)."""
    effect = next(effect for effect in DEFAULT_EFFECTS if effect.label == label)
    model, left = Model((effect,), []), iter(misfits)
    base = base_of_three_frames(clamped=False)

    def fit(secant, weighted, parameters, options):
        values = secant._last[0] + 1.0
        return SimpleNamespace(values=values, positions=model.positions(values), reduced_chi_square=1.0)

    monkeypatch.setattr(fitting, "fit", fit)
    monkeypatch.setattr(fitting, "negative_log_likelihood", lambda base, errors, here: next(left))
    monkeypatch.setattr(fitting, "_doubt", lambda base, errors, here: 1.0)
    monkeypatch.setattr(fitting, "deviations_of", lambda *of: np.zeros(1))
    monkeypatch.setattr(fitting, "hypothesis_at", lambda base, errors, model, values, *of, **named: values)
    start = np.zeros(1 + len(effect.doses))
    errors = SimpleNamespace(variance=None)
    found = refit(base, errors, model, start, np.ones((3, len(start), 1, 3)), options=GapOptions())
    assert model.taken == taken
    assert found[0] == 1.0 + len(taken)


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("clamped", "there", "ends", "weights"),
    [
        (True, 1.0, 2.0, [50.0, 1.0]),  # what is left at the other place is noise, which keeps priors weak
        (True, -1.0, 1.0, [50.0, 1.0]),  # it is not as likely
        (False, 1.0, 1.0, [50.0]),  # no priors
    ],
)
def test_a_held_body_is_fitted_from_weak_priors_too(
    monkeypatch: pytest.MonkeyPatch, clamped: bool, there: float, ends: float, weights: list[float]
) -> None:
    """A load with another ν: strong priors left a smooth residual, which kept them strong (2301/043)."""
    effect = next(effect for effect in DEFAULT_EFFECTS if effect.label == "damping")
    model, doubts = Model((effect,), []), []
    base = base_of_three_frames(clamped=clamped)

    def fit(secant, weighted, parameters, options):
        doubts.append(secant.model.doubt)
        values = np.array([1.0 if secant.model.doubt > 2 else 2.0, 0.0])  # what priors of that weight let it be
        return SimpleNamespace(values=values, positions=model.positions(values), reduced_chi_square=1.0)

    def stated(base, errors, model, values, *of, **named):
        return SimpleNamespace(values=values, evidence=there * (values[0] - 1.0))

    monkeypatch.setattr(fitting, "fit", fit)
    monkeypatch.setattr(fitting, "negative_log_likelihood", lambda base, errors, here: 1.0)
    monkeypatch.setattr(fitting, "_doubt", lambda base, errors, here: 1.0 if here[0, 0, 0] == 2.0 else 50.0)
    monkeypatch.setattr(fitting, "deviations_of", lambda *of: np.zeros(2))
    monkeypatch.setattr(fitting, "hypothesis_at", stated)
    found = refit(base, SimpleNamespace(variance=None), model, np.zeros(2), np.ones((3, 2, 1, 3)), options=GapOptions())
    assert found.values[0] == ends
    assert list(dict.fromkeys(doubts)) == weights
