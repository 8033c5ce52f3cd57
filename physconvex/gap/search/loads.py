"""A held body with a load at its free end: E and load are looked for together, along the line of one frequency.

A load makes a body sag further and swing slower. So does less stiffness, in another proportion: a fit of E alone ends
between the two, out of step, and from there no load looks right. How fast the recording swings is known by itself, and
to each load belongs one E at which the loaded body swings so; of these pairs the recording chooses.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.lowest_mode import lowest_frequency
from physconvex.gap.base.model import MODULUS, EffectModel
from physconvex.gap.effects.effect import Effect
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.search.damped_sine import recorded_ringing
from physconvex.gap.search.evidence import negative_log_likelihood
from physconvex.gap.thresholds import SEARCH

__all__ = ["loaded_starts"]

_LABELS = ("attached_mass ({})", "attached_mass ({}, loose)", "damping")
Start = tuple[tuple[Effect, ...], np.ndarray]


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
    assert scene.pins is not None
    vertices = scene.body.mesh.vertices
    low, high = vertices.min(0), vertices.max(0)
    away = 0.5 * (low + high) - vertices[scene.pins.nodes].mean(0)
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
