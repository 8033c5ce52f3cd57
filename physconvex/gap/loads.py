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
from physconvex.gap.baseline import Baseline
from physconvex.gap.comparison import mean_square
from physconvex.gap.effects import Effect
from physconvex.gap.model import EffectModel
from physconvex.gap.own_elements import lowest_frequency
from physconvex.gap.ringing import recorded_ringing
from physconvex.gap.score import ErrorModel

__all__ = ["loaded_starts"]

_RATIOS = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # masses of the load over the body's
_ABOUT = (-0.05, 0.0, 0.05, 0.1, 0.15)  # decades of E about that frequency: a body that sags far swings otherwise
_BOUNDS = (3.0, 8.0)  # of log10 E
_LABELS = ("attached_mass ({})", "attached_mass ({}, loose)", "damping")
_MODULUS = "log10_youngs_modulus"
Start = tuple[tuple[Effect, ...], np.ndarray]


def loaded_starts(base: Baseline, errors: ErrorModel, dictionary: Iterable[Effect]) -> list[Start]:
    """Effects and values to begin fits at: a load, fixed or loose, alone and with damping; none where none fits best.

    Args:
        base: of the model that searches.
        errors: weights of the residuals.
        dictionary: effects that are tried.
    """
    recorded, known, end = recorded_ringing(base), {effect.label: effect for effect in dictionary}, _free_end(base)
    load, loose, damping = (known.get(name.format(end)) for name in _LABELS)
    if recorded is None or load is None or _MODULUS not in base.model.base:
        return []
    damped = () if damping is None else (damping,)
    # what damps the main shape by the ratio that was recorded, E in proportion to viscosity
    dose = max(recorded.ratio, 0.0) / (np.pi * recorded.frequency)
    model = replace(base.model, effects=(load, *damped), correction=None, frames=int(base.split.fitted[-1]) + 1)
    tried: list[tuple[float, float, np.ndarray]] = []
    for ratio in _RATIOS:
        values = np.concatenate([base.fit.values[: len(model.base)], [ratio], np.full(len(damped), dose)])
        for log_modulus in _moduli(model, values, recorded.frequency):
            values = values.copy()
            values[model.base.index(_MODULUS)] = log_modulus
            tried.append((_misfit(base, errors, model, values), ratio, values))
    misfit, ratio, values = min(tried, key=lambda one: one[0])
    if not np.isfinite(misfit) or ratio == 0.0:
        return []
    plain, doses, place = values[: len(model.base)], values[len(model.base) + 1 :], len(model.base)
    starts: list[Start] = [((load, *damped), values), ((load,), values[: place + 1])]
    if loose is not None:
        slack = loose.doses[1].trial(base.situation)
        starts.append(((loose, *damped), np.concatenate([plain, [ratio, slack], doses])))
    return starts


def _free_end(base: Baseline) -> str:
    """The end that is farthest from what is held, as variants of the effect call it."""
    scene = base.model.full_scene(base.fit.values)
    assert scene.pins is not None
    vertices = scene.body.mesh.vertices
    low, high = vertices.min(0), vertices.max(0)
    away = 0.5 * (low + high) - vertices[scene.pins.nodes].mean(0)
    axis = int(np.argmax(np.abs(away)))
    return f"{'-' if away[axis] < 0 else '+'}{'xyz'[axis]}"


def _moduli(model: EffectModel, values: np.ndarray, frequency: float) -> list[float]:
    """log10 E at which the loaded body's lowest vibration has a frequency [Hz], and some about it."""
    at = float(values[model.base.index(_MODULUS)]) + 2 * np.log10(frequency / lowest_frequency(model, values))
    return [float(np.clip(at + more, *_BOUNDS)) for more in _ABOUT]


def _misfit(base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray) -> float:
    """Mean square of the fitted frames' residuals over the expected one; infinite where nothing comes out."""
    try:
        positions = model.positions(values)
    except (ConvergenceError, InputError):
        return np.inf
    whole = np.concatenate([positions, base.positions[len(positions) :]])
    return mean_square(base, errors, whole, base.split.fitted)
