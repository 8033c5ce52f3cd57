"""The complete diagnosis of one capture."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import physconvex
from physconvex.errors import ConvergenceError
from physconvex.gap.base.base_fit import fit_baseline
from physconvex.gap.base.baseline import Baseline, Report, shortened
from physconvex.gap.base.cost import Cost
from physconvex.gap.base.observed_points import lost_points
from physconvex.gap.base.rough_fit import rough_baseline
from physconvex.gap.conditions.capture_elements import with_own_elements
from physconvex.gap.conditions.setting import find_setting
from physconvex.gap.effects.catalogue import choose
from physconvex.gap.effects.effect import Effect
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.errors.error_model import detail_errors, error_model, error_scale
from physconvex.gap.errors.numerical_differences import (
    Numerics,
    correction_of,
    numerical_differences,
    with_absorbed_mesh,
)  # fmt: skip
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screening, screen
from physconvex.gap.judgement.caveats import next_experiment
from physconvex.gap.judgement.naming import favoured
from physconvex.gap.judgement.residual_measures import measure, relative_gap
from physconvex.gap.judgement.verdict import decide
from physconvex.gap.light.image_formation import image_findings, with_pictures
from physconvex.gap.location.where import locate_gap
from physconvex.gap.options import GapOptions
from physconvex.gap.page.findings import Provenance
from physconvex.gap.page.report import GapReport
from physconvex.gap.search.effect_fits import fit_effects
from physconvex.gap.search.full_order import as_reduced
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis
from physconvex.gap.search.search_state import FAILURES
from physconvex.gap.search.selection import select_effects
from physconvex.gap.shrinkage import HowFar, held_out_views, second_take_shrinkage, shrinkage_on
from physconvex.gap.thresholds import BASE_FIT, CLOCK, NUMERICAL_ERROR, RUN_COST, SCREENING
from physconvex.io import Capture, load_capture
from physconvex.mesh import TetMesh

_CUT = (
    "The search was cut short after the {:.0f} seconds that it is given: this is the best of what had been found. A "
    "faster machine, or one with less else to do, might find more."
)


def diagnose(
    capture: Capture | Path | str,
    *,
    second_take: Capture | Path | str | None = None,
    effects: Sequence[str] | None = None,
    without: Iterable[str] = (),
    extra: Iterable[Effect] = (),
    options: GapOptions | None = None,
    on_progress: Report | None = None,
) -> GapReport:
    """Locate the gap between a capture and its base model, find its cause, and measure how far it shrinks.

    The base model follows `capture.json`, with E, ν and the unstated initial motion fitted; only 100 frames count.

    Args:
        capture: a capture folder with rest geometry and marker tracks or videos.
        second_take: another capture of the same body; the shrinkage is also reported on it.
        effects: names of the effects to try; all by default.
        without: names to leave out.
        extra: additional user-defined effects.
        options: settings; blind tests run with the defaults.
        on_progress: receives progress messages.

    Raises:
        InputError: the capture lacks something, or an effect's name is unknown; the message says what.
        ConvergenceError: the base model cannot be simulated.
    """
    begun, options = time.monotonic(), GapOptions.or_default(options)
    capture = shortened(capture if isinstance(capture, Capture) else load_capture(capture))
    other = load_capture(second_take) if isinstance(second_take, Path | str) else second_take
    dictionary = choose(effects, without=without, extra=extra)
    report: Report = on_progress or (lambda _: None)
    cost = Cost(options.deadline)
    cost.allow(np.inf, CLOCK.base_fit_ends)
    setting = find_setting(rough_baseline(capture, options, report, cost=cost), options, report)
    rough = setting.base
    near = setting.damped or rough  # errors are estimated near the recording
    numerics = numerical_differences(near, options, report)
    rough_errors = error_model(near, numerics, options)
    fine = numerics.fine if near is rough else _motion_on_fine_mesh(rough, numerics)
    base = fit_baseline(rough, correction_of(numerics), fine, rough_errors.variance, options=options, report=report)
    base, numerics = with_own_elements(
        base, rough, numerics, rough_errors.variance, options=options, report=report, known=setting.own
    )
    base = _with_directions(base, numerics)
    numerics = with_absorbed_mesh(base, numerics, options)
    base, errors, screening = _trusted(base, numerics, dictionary, options, report)
    weights = detail_errors(base, errors, options.detail)
    found = select_effects(
        base, weights, numerics, dictionary, options=options, report=report, screening=screening, near=setting.damped
    )
    base, hypotheses, screening, numerics = found.base, found.hypotheses, found.screening, found.numerics
    if found.errors is not weights:  # new weights, far from the base fit
        errors = weights = found.errors
    best = favoured(hypotheses) or hypotheses[0]
    cost.allow(RUN_COST.placebo, CLOCK.placebo_ends)
    report("placebo")
    placebo = _placebo(base, weights, screening, best, options)
    shrinkage = _shrinkages(base, errors, best, placebo, options)
    verdict = decide(
        hypotheses, screening, measure(base, errors, weights, best, hypotheses, shrinkage=shrinkage), options
    )
    shrinkage = (*shrinkage, *held_out_views(base, best, placebo, options))
    if other is not None:
        again = second_take_shrinkage(base, best, other, options, report)
        shrinkage = (*shrinkage, *(() if again is None else (again,)))
    report("pictures")
    pictures = image_findings(base, dictionary, options)
    verdict = with_pictures(verdict, pictures)
    caveats = [*verdict.caveats, *lost_points(base.observations)]
    if cost.cut:
        caveats.append(_CUT.format(options.deadline))
    if capture.frames == BASE_FIT.most_frames:
        caveats.append(f"At most the first {BASE_FIT.most_frames} frames were used.")
    verdict = replace(verdict, caveats=tuple(caveats))
    report("report")
    return GapReport(
        where=locate_gap(base, errors, best, options),
        verdict=verdict,
        how_far=shrinkage,
        pictures=pictures,
        base=base,
        best=best,
        hypotheses=tuple(hypotheses),
        screening=screening,
        next_experiment=next_experiment(verdict, base.situation),
        provenance=_provenance(base, numerics, screening, time.monotonic() - begun),
        options=options,
    )


def _motion_on_fine_mesh(rough: Baseline, numerics: Numerics) -> tuple[TetMesh, PointMotion] | None:
    """The finer mesh and the base model's motion on it; None without one. For differences of another model."""
    if numerics.fine is None:
        return None
    mesh = numerics.fine[0]
    try:
        return mesh, replace(rough.model, mesh=mesh).motion(rough.fit.values)
    except ConvergenceError:
        return None


def _trusted(
    base: Baseline, numerics: Numerics, dictionary: Sequence[Effect], options: GapOptions, report: Report
) -> tuple[Baseline, ErrorModel, Screening | None]:
    """The base fit and the weights of its residuals, renewed if the numerical error is less than expected.

    Also the screening at that fit, if it is still valid.
    """
    errors = error_model(base, numerics, options)
    correction = base.model.correction
    swamped = relative_gap(base, errors, base_hypothesis(base, errors)) < 1.0
    if correction is None or (base.situation.clamped and not swamped):
        return base, errors, None
    screening = screen(as_reduced(base), errors, numerics, dictionary, report)
    scale = error_scale(base, errors, screening)
    if scale.min() > NUMERICAL_ERROR.fit_anew:
        return base, errors, None if base.situation.clamped else screening  # details of a held body count less
    errors = error_model(base, numerics, options, scale=scale)
    if scale.max() > NUMERICAL_ERROR.fit_anew:  # the errors change only in frames outside the fit
        return base, errors, None if base.situation.clamped else screening
    fine = None if base.model.mesh is None else (base.model.mesh, base.motion)
    base = _with_directions(
        fit_baseline(base, correction, fine, errors.variance, options=options, report=report), numerics
    )
    return base, error_model(base, numerics, options, scale=scale), None


def _with_directions(base: Baseline, numerics: Numerics) -> Baseline:
    """The effects, with the motions of the numerical ones."""
    return replace(base, model=replace(base.model, directions=numerics.directions))


def _placebo(
    base: Baseline, errors: ErrorModel, screening: Screening, best: Hypothesis, options: GapOptions
) -> Hypothesis | None:
    """A fit of the effect with the lowest score among the visible ones."""
    own = [entry for entry in screening.ranked if entry.effect in best.effects]
    other = next(
        (
            entry
            for entry in reversed(screening.one_per_name)
            if entry.effect.name not in best.names
            and entry.effect.source != "numerical"
            and all(screening.similarity(entry, one) < SCREENING.same_as_placebo for one in own)
        ),
        None,
    )
    if other is None:
        return None
    try:
        return fit_effects(as_reduced(base), errors, [other], options)
    except FAILURES:
        return None


def _shrinkages(
    base: Baseline, errors: ErrorModel, best: Hypothesis, placebo: Hypothesis | None, options: GapOptions
) -> tuple[HowFar, ...]:
    """Shrinkage on the frames reserved for the report, then on all held-out frames."""
    split = base.split
    pairs = [(split.reporting, "held-out frames that chose nothing"), (split.held_out, "all held-out frames")]
    other = None if placebo is None else (placebo.label, placebo.positions)
    return tuple(
        shrinkage_on(
            base, errors, best.positions, placebo=other, frames=np.unique(frames),
            data=f"{data}, {frames.min()} to {frames.max()}", options=options,
        )
        for frames, data in pairs
        if len(frames)
    )  # fmt: skip


def _provenance(base: Baseline, numerics: Numerics, screening: Screening, seconds: float) -> Provenance:
    split, steps = base.split, base.model.twin.steps_per_frame
    return Provenance(
        capture=base.capture.folder.resolve().name,
        version=physconvex.__version__,
        nodes=numerics.nodes[1],
        steps_per_frame=steps,
        numerical_viscosity=base.situation.youngs_modulus / (base.capture.fps * steps),
        fitted=tuple(split.fitted.tolist()),
        selecting=tuple(split.selecting.tolist()),
        reporting=tuple(split.reporting.tolist()),
        simulations_failed=(*numerics.failed, *screening.failed),
        seconds=seconds,
    )
