"""Start points of the search for effects, in addition to the base fit.

**First frames** (`early_point`). Over all frames E and ν absorb a part of an effect (plastic flow looks like a body a
decade softer), and at such a fit no dose helps. Effects accumulate over time. The first frames that determine E at all
contain less of the effect: prediction error instead of output error, at the price of more noise.

**Flight** (`from_flight`). In flight a body hardly deforms, so neither E nor ν can absorb wind, a clock or a throw, and
a fit has one minimum. After an impact E has many minima, and the base fit may be decades from the one that suits the
effect. The flight therefore determines the effects, the first contact then determines E, and the reduced model is
corrected there.

**Load** (`loaded_starts`). A load makes a held body sag further and vibrate more slowly. So does a lower stiffness, in
another proportion. A fit of E alone ends between the two, out of phase, and no load helps from there. The vibration
frequency of the recording is known independently, and for each load one E gives the loaded body that frequency. The
recording selects among these pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline, Report, derivatives_of_residuals
from physconvex.gap.base.model import MODULUS, RATIO, EffectModel
from physconvex.gap.effects.effect import IN_FLIGHT, Effect
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screened, best_pairs, screen
from physconvex.gap.options import GapOptions
from physconvex.gap.search.damped_sine import recorded_ringing
from physconvex.gap.search.effect_fits import derivatives_at, fit_effects, misfit_at
from physconvex.gap.search.evidence import mean_square
from physconvex.gap.search.full_order import fitted_there
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.thresholds import SEARCH
from physconvex.identify import FitOptions, fit

_LABELS = ("attached_mass ({})", "attached_mass ({}, loose)", "damping")
Start = tuple[tuple[Effect, ...], np.ndarray]


def early_window(base: Baseline, errors: ErrorModel) -> int | None:
    """Number of first frames that determine E well enough; None if that takes nearly all of the fitted ones."""
    names = base.model.base
    if MODULUS not in names:
        return None
    count = base.split.end
    lowest = max(6, count // 3) if base.first_contact is None else base.first_contact + 2
    here = base.positions[: len(base.tangents)]
    columns = derivatives_of_residuals(base, here, base.tangents)
    scales = np.array([p.step for p in base.model.parameters(base.fit.values)])[: len(columns)]
    for window in range(lowest, int(SEARCH.early_longest * count) + 1):
        rows = base.rows(np.arange(window))
        whitened = errors.restricted(rows).whiten(columns[:, rows]) * scales[:, None]
        information = whitened @ whitened.T + 1e-8 * np.eye(len(scales))
        index = names.index(MODULUS)
        if np.sqrt(np.linalg.inv(information)[index, index]) * scales[index] < SEARCH.early_told:
            return window
    return None


def early_point(base: Baseline, errors: ErrorModel, options: GapOptions, report: Report) -> Baseline | None:
    """The baseline at the fit of the first frames; None without such a window, or for the same result."""
    window = early_window(base, errors)
    if window is None:
        return None
    report("fit of the base model to the first frames")
    shorter, values = replace(base.model, frames=window), base.fit.values
    weighted = base.weighted(errors.variance, window)
    secant = shorter.secant(values, base.positions[:window], base.tangents[:window])
    stop = FitOptions(max_iterations=options.iterations + 3, relative_tolerance=2e-3, absolute_tolerance=0.1)
    try:
        found = fit(secant, weighted, shorter.parameters(values), options=stop)
        index = base.model.base.index(MODULUS)
        if abs(found.values[index] - values[index]) < SEARCH.early_apart:
            return None
        motion = base.model.motion(found.values)
        tangents = derivatives_at(base, base.model, found.values, motion)
    except ConvergenceError:
        return None
    here = replace(base.fit, parameters=base.model.parameters(found.values), values=found.values)
    return replace(base, fit=here, motion=motion, tangents=tangents)


def from_flight(search: EffectSearch, numerics: Numerics, dictionary: Sequence[Effect]) -> None:
    """If the best fit leaves a gap, fit effects to the flight before the first contact, and then the rest."""
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
        search.attempt(f"{told.label}, from the flight", partial(_fitted, search, told))


def _told(search: EffectSearch, flight: Baseline, choices: Sequence[Sequence[Screened]]) -> list[Hypothesis]:
    """Combinations of effects fitted to the flight, the best first."""
    found = []
    for chosen in choices:
        search.report(f"flight: {' + '.join(entry.effect.label for entry in chosen)}")
        with suppress(*FAILURES):
            found.append(fit_effects(flight, search.errors, chosen, search.options))
    return sorted(found, key=lambda h: h.fitted)


def _flight(base: Baseline) -> Baseline | None:
    """The baseline of the frames before the one ahead of the first contact; None if these are few."""
    if base.situation.clamped or base.first_contact is None:
        return None
    fitted = base.split.fitted[base.split.fitted < base.first_contact - 1]
    return None if len(fitted) < SEARCH.flight_frames else replace(base, split=replace(base.split, fitted=fitted))


def _fitted(search: EffectSearch, told: Hypothesis) -> Hypothesis:
    """Initial motion and doses from the flight, E from the first contact, then all together, kind by kind."""
    base, values = search.base, told.values.copy()
    for place, name in enumerate(base.model.base):
        if not name.startswith("initial"):  # a flight does not inform it
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
    """The values with the best fitting E of some moduli, and an ordinary ν, in the frames of a model."""
    base, names = search.base, search.base.model.base
    place = names.index(MODULUS)
    bounds = model.parameters(values)[place]
    best, least = values, float("inf")
    for modulus in np.unique(np.clip(moduli, bounds.lower, bounds.upper)):
        moved = values.copy()
        moved[place] = modulus
        if RATIO in names:
            moved[names.index(RATIO)] = SEARCH.flight_poisson_ratio
        misfit = misfit_at(base, search.errors, model, moved)
        if misfit < least:
            best, least = moved, misfit
    return best


def loaded_starts(base: Baseline, errors: ErrorModel, dictionary: Iterable[Effect]) -> list[Start]:
    """Effects and start values: a load, fixed or loose, alone and with damping; empty if no load fits best.

    `base` belongs to the searching model, possibly at a fit with other effects, which the load then joins.
    """
    recorded, known, end = recorded_ringing(base), {effect.label: effect for effect in dictionary}, _free_end(base)
    load, loose, damping = (known.get(name.format(end)) for name in _LABELS)
    if recorded is None or load is None or MODULUS not in base.model.base:
        return []
    known_already = base.model.effects
    damped = () if damping is None or "damping" in {e.name for e in known_already} else (damping,)
    # gives the main shape the recorded damping ratio, E in proportion to viscosity
    dose = max(recorded.ratio, 0.0) / (np.pi * recorded.frequency)
    model = replace(base.model, effects=(*known_already, load, *damped), correction=None, frames=base.split.end)
    frequency, here, tried = recorded.frequency / _clock(base), len(base.fit.values), []
    for ratio in SEARCH.load_ratios:  # at the very end; a larger load further in looks nearly the same
        values = np.concatenate([base.fit.values, [ratio, 0.0], np.full(len(damped), dose)])
        tried.append(_best_modulus(base, errors, model, values, frequency))
    misfit, values = min(tried, key=lambda one: one[0])
    if not np.isfinite(misfit) or values[here] == 0.0:
        return []
    loaded = here + len(load.doses)
    starts: list[Start] = [(model.effects, values), ((*known_already, load), values[:loaded])]
    if loose is not None:
        effects, trial = (*known_already, loose, *damped), loose.doses[-1].trial(base.situation)
        hanging = [np.insert(values, loaded, share * trial) for share in SEARCH.load_slacks]
        model = replace(model, effects=effects)
        starts.append((effects, min(hanging, key=lambda one: misfit_at(base, errors, model, one))))
    return starts


def _clock(base: Baseline) -> float:
    """Ratio of the recording's clock rate to the model's, from the fit."""
    doses = zip(base.model.effects, base.model.slices, strict=True)
    return next((1.0 + float(base.fit.values[where][0]) for e, where in doses if e.name == "time_scale"), 1.0)


def _free_end(base: Baseline) -> str:
    """The end farthest from the held part, as variants of the effect name it."""
    scene = base.model.full_scene(base.fit.values)
    assert scene.held is not None
    vertices = scene.body.mesh.vertices
    low, high = vertices.min(0), vertices.max(0)
    away = 0.5 * (low + high) - vertices[scene.held.nodes].mean(0)
    axis = int(np.argmax(np.abs(away)))
    return f"{'-' if away[axis] < 0 else '+'}{'xyz'[axis]}"


def _best_modulus(
    base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray, frequency: float
) -> tuple[float, np.ndarray]:
    """Misfit and values with the best E, by descent from that whose lowest vibration has a frequency [Hz]."""
    index = model.base.index(MODULUS)
    line = float(values[index]) + 2 * np.log10(frequency / model.lowest_frequency(values))

    def at(step: int) -> tuple[float, np.ndarray]:
        changed = values.copy()
        changed[index] = np.clip(line + SEARCH.load_step * step, *SEARCH.load_moduli)
        return misfit_at(base, errors, model, changed), changed

    best, where = at(0), 0
    for way in (1, -1):
        while abs(where + way) <= SEARCH.load_farthest and (found := at(where + way))[0] < best[0]:
            best, where = found, where + way
        if where:
            break
    return best
