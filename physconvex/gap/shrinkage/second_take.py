"""How far the gap shrinks on a second recording of the same body, of which nothing but the start is fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.base_fit import rough_baseline
from physconvex.gap.base.baseline import FLOOR_LAW, Baseline, Report
from physconvex.gap.conditions.setting import find_setting
from physconvex.gap.errors.numerics import other_mesh
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.shrinkage.how_far import HowFar, shrinkage_on
from physconvex.io import Capture

__all__ = ["second_take_shrinkage"]

_MATERIAL = ("log10_youngs_modulus", "poisson_ratio", *FLOOR_LAW)


def second_take_shrinkage(
    base: Baseline, best: Hypothesis, take: Capture, options: GapOptions, report: Report
) -> HowFar | None:
    """Shrinkage on another take: E, ν and doses from the first, the unstated initial motion from the second's start.

    Args:
        base: base fit of the first take.
        best: its best fit with effects.
        take: the second capture.
        options: settings.
        report: told what is done.

    Returns:
        None where one of the two models cannot be run on it.

    Raises:
        InputError: the take lacks something, or an effect of the fit makes no sense there (no floor, not held).
    """
    own = rough_baseline(take, options, report)
    if base.situation.giving_floor:
        own = find_setting(own, options, report).base
    lost = [e.label for e in best.effects if not e.applies(replace(own.situation, touches=own.situation.floor))]
    if lost:
        raise InputError(
            f"second take {take.folder}: {', '.join(lost)} cannot act there; record the same kind of motion again"
        )
    report("second take")
    own = _as_fine(own, base, options)
    try:
        plain = _with_material(own, base.fit.values, base.model.base)
        values = np.concatenate([_with_material(own, best.values, best.model.base).fit.values, *(
            best.doses(effect)[0] for effect in best.effects
        )])  # fmt: skip
        model = replace(own.model, effects=best.effects)
        plain = replace(plain, motion=plain.model.motion(plain.fit.values))
        improved = model.positions(values)
    except ConvergenceError:
        return None
    errors = ErrorModel.of_noise(len(plain.residual(plain.positions)))
    frames = np.unique(plain.observations.frames)
    return shrinkage_on(plain, errors, improved, None, frames, "second take, all frames", options)


def _as_fine(own: Baseline, first: Baseline, options: GapOptions) -> Baseline:
    """The second take's model on as fine a mesh as the first one's, since a coarser one would be stiffer."""
    if first.model.mesh is None:
        return own
    try:
        mesh = other_mesh(own, options, own.model.frames * own.model.twin.steps_per_frame)
    except InputError:
        return own
    return replace(own, model=replace(own.model, mesh=mesh))


def _with_material(own: Baseline, values: np.ndarray, names: tuple[str, ...]) -> Baseline:
    """The second take's baseline with the first one's material."""
    changed = own.fit.values.copy()
    for name in _MATERIAL:
        if name in names and name in own.model.base:
            changed[own.model.base.index(name)] = values[names.index(name)]
    return replace(own, fit=replace(own.fit, values=changed))
