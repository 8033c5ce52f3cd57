"""Effects that show before anything is touched: told by the flight alone, then E is looked for again beside them.

In flight a body hardly deforms, so that neither E nor ν can absorb what wind, a clock or a throw do there, and a fit
has one minimum; after an impact E has many, and at the base fit it may be decades from the one that suits the effect.
So E is looked for by the first contact alone, and the reduced model is corrected anew where that puts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.model import MODULUS, EffectModel
from physconvex.gap.effects.effect import IN_FLIGHT, Effect
from physconvex.gap.errors.numerics import Numerics
from physconvex.gap.errors.screening import Screened, best_pairs, screen
from physconvex.gap.search.effect_fits import fit_effects
from physconvex.gap.search.evidence import mean_square, negative_log_likelihood
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.search.rounds import fitted_there
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.thresholds import SEARCH

__all__ = ["from_flight"]


def from_flight(search: EffectSearch, numerics: Numerics, dictionary: Sequence[Effect]) -> None:
    """Fit what the flight before the first contact tells, and from there the rest, if the best fit leaves it open."""
    flight = _flight(search.base)
    if flight is None or search.late or MODULUS not in search.base.model.base:
        return
    if mean_square(flight, search.errors, search.best.positions, flight.split.fitted) < SEARCH.flight_open:
        return
    shown = [effect for effect in dictionary if effect.source in IN_FLIGHT]
    screening = screen(flight, search.errors, numerics, shown, search.report)
    alone, paired = SEARCH.flight_screened
    singles: list[tuple[Screened, ...]] = [(entry,) for entry in screening.one_per_name[:alone]]
    pairs: list[tuple[Screened, ...]] = [(pair.first, pair.second) for pair in best_pairs(screening, paired)]
    alone, paired = SEARCH.flight_fitted
    for told in (*_told(search, flight, singles)[:alone], *_told(search, flight, pairs)[:paired]):
        search.attempt(f"{told.label}, from the flight", lambda h=told: _fitted(search, h))  # type: ignore[misc]


def _told(search: EffectSearch, flight: Baseline, choices: Sequence[Sequence[Screened]]) -> list[Hypothesis]:
    """Choices of effects fitted to the flight, the best first."""
    found = []
    for chosen in choices:
        search.report(f"flight: {' + '.join(entry.effect.label for entry in chosen)}")
        with suppress(*FAILURES):
            found.append(fit_effects(flight, search.errors, chosen, search.options))
    return sorted(found, key=lambda h: h.fitted)


def _flight(base: Baseline) -> Baseline | None:
    """The baseline of the frames before the one ahead of the first contact; None where these are few."""
    if base.situation.clamped or base.first_contact is None:
        return None
    fitted = base.split.fitted[base.split.fitted < base.first_contact - 1]
    return None if len(fitted) < SEARCH.flight_frames else replace(base, split=replace(base.split, fitted=fitted))


def _fitted(search: EffectSearch, told: Hypothesis) -> Hypothesis:
    """Initial motion and doses as the flight has them, E by the first contact, then all together, kind by kind."""
    base, values = search.base, told.values.copy()
    for place, name in enumerate(base.model.base):
        if not name.startswith("initial"):  # of which the flight says nothing
            values[place] = base.fit.values[place]
    place = base.model.base.index(MODULUS)
    bare = replace(base.model, effects=told.effects, correction=None)
    full = replace(search.full.model, effects=told.effects)
    last = base.split.end
    assert base.first_contact is not None
    first = min(base.first_contact + SEARCH.flight_contact, last)
    moduli = values[place] + np.arange(*SEARCH.flight_moduli)
    values = _best_material(search, replace(bare, frames=first), values, moduli)
    moduli = values[place] + np.array(SEARCH.flight_moduli_full)
    values = _best_material(search, replace(full, frames=last), values, moduli)
    return fitted_there(search, full, values, by_kind=True)


def _best_material(search: EffectSearch, model: EffectModel, values: np.ndarray, moduli: np.ndarray) -> np.ndarray:
    """The values with that of some moduli, and an ordinary ν, at which they fit the frames of a model best."""
    base, names = search.base, search.base.model.base
    place = names.index(MODULUS)
    bounds = model.parameters(values)[place]
    best, least = values, float("inf")
    for modulus in np.unique(np.clip(moduli, bounds.lower, bounds.upper)):
        moved = values.copy()
        moved[place] = modulus
        if "poisson_ratio" in names:
            moved[names.index("poisson_ratio")] = SEARCH.flight_poisson_ratio
        try:
            misfit = negative_log_likelihood(base, search.errors, model.positions(moved))
        except ConvergenceError:
            continue
        if misfit < least:
            best, least = moved, misfit
    return best
