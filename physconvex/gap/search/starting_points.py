"""Points beside the base fit from which effects are looked for.

**First frames** (`early_point`). Over all frames E and ν absorb what they can of an effect (plastic flow looks like a
body a decade softer), and at such a fit no dose looks right. What an effect does adds up over time, so that the first
frames which tell E at all tell it with less of the effect in it: prediction error in the place of output error, at
the price of more noise.

**Flight** (`from_flight`). In flight a body hardly deforms, so that neither E nor ν can absorb what wind, a clock or
a throw do there, and a fit has one minimum; after an impact E has many, and at the base fit it may be decades from
the one that suits the effect. So effects are told by the flight alone, then E is looked for by the first contact, and
the reduced model is corrected anew where that puts it.

**A load** (`loaded_starts`). A load makes a held body sag further and swing slower. So does less stiffness, in
another proportion: a fit of E alone ends between the two, out of step, and from there no load looks right. How fast
the recording swings is known by itself, and to each load belongs one E at which the loaded body swings so; of these
pairs the recording chooses.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline, Report, derivatives_of_residuals
from physconvex.gap.base.lowest_mode import lowest_frequency
from physconvex.gap.base.model import MODULUS, EffectModel
from physconvex.gap.effects.effect import IN_FLIGHT, Effect
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screened, best_pairs, screen
from physconvex.gap.options import GapOptions
from physconvex.gap.search.damped_sine import recorded_ringing
from physconvex.gap.search.effect_fits import derivatives_at, fit_effects
from physconvex.gap.search.evidence import mean_square, negative_log_likelihood
from physconvex.gap.search.full_order import fitted_there
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.thresholds import SEARCH
from physconvex.identify import FitOptions, fit

_LABELS = ("attached_mass ({})", "attached_mass ({}, loose)", "damping")
Start = tuple[tuple[Effect, ...], np.ndarray]


def early_window(base: Baseline, errors: ErrorModel) -> int | None:
    """Number of first frames that tell E well enough; None where that takes nearly all of the fitted ones."""
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
    """The baseline at the fit of the first frames; None where there is no such window, or it says the same."""
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


def loaded_starts(base: Baseline, errors: ErrorModel, dictionary: Iterable[Effect]) -> list[Start]:
    """Effects and values to begin fits at: a load, fixed or loose, alone and with damping; none where none fits best.

    Args:
        base: of the model that searches, at a fit with other effects perhaps: the load then comes beside these.
        errors: weights of the residuals.
        dictionary: effects that are tried.
    """
    recorded, known, end = recorded_ringing(base), {effect.label: effect for effect in dictionary}, _free_end(base)
    load, loose, damping = (known.get(name.format(end)) for name in _LABELS)
    if recorded is None or load is None or MODULUS not in base.model.base:
        return []
    known_already = base.model.effects
    damped = () if damping is None or "damping" in {e.name for e in known_already} else (damping,)
    # what damps the main shape by the ratio that was recorded, E in proportion to viscosity
    dose = max(recorded.ratio, 0.0) / (np.pi * recorded.frequency)
    model = replace(base.model, effects=(*known_already, load, *damped), correction=None, frames=base.split.end)
    frequency, here, tried = recorded.frequency / _clock(base), len(base.fit.values), []
    for ratio in SEARCH.load_ratios:  # at the very end: further in, a larger one looks nearly alike
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
        starts.append((effects, min(hanging, key=lambda one: _misfit(base, errors, model, one))))
    return starts


def _clock(base: Baseline) -> float:
    """How much faster the recording's clock runs than the model's, by the fit."""
    for effect, where in zip(base.model.effects, base.model.slices, strict=True):
        if effect.name == "time_scale":
            return 1.0 + float(base.fit.values[where][0])
    return 1.0


def _free_end(base: Baseline) -> str:
    """The end that is farthest from what is held, as variants of the effect call it."""
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
    """Misfit and values with the E that fits best, down from where the lowest vibration has a frequency [Hz]."""
    index = model.base.index(MODULUS)
    line = float(values[index]) + 2 * np.log10(frequency / lowest_frequency(model, values))

    def at(step: int) -> tuple[float, np.ndarray]:
        changed = values.copy()
        changed[index] = np.clip(line + SEARCH.load_step * step, *SEARCH.load_moduli)
        return _misfit(base, errors, model, changed), changed

    best, where = at(0), 0
    for way in (1, -1):
        while abs(where + way) <= SEARCH.load_farthest and (found := at(where + way))[0] < best[0]:
            best, where = found, where + way
        if where:
            break
    return best


def _misfit(base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray) -> float:
    """Of the fitted frames; infinite where nothing comes out."""
    try:
        return negative_log_likelihood(base, errors, model.positions(values))
    except (ConvergenceError, InputError):
        return np.inf
