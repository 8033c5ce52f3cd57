"""How far the gap shrinks in views that nothing was fitted to: points followed in the videos of the other cameras."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.body_modes import undivided
from physconvex.gap.base.observed_points import followed
from physconvex.gap.effects.effect import Effect
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.shrinkage.how_far import HowFar, Positions, shrinkage_on
from physconvex.identify import PixelObservations

__all__ = ["held_out_views"]

_OF_ONE_CAMERA = ("camera_pose", "focal_length", "lens_distortion", "rolling_shutter")


def held_out_views(
    base: Baseline, best: Hypothesis, placebo: Hypothesis | None, options: GapOptions
) -> tuple[HowFar, ...]:
    """Shrinkage in all frames of each further camera that has a video in which points can be followed.

    Every model is run once more, for the points that the other cameras see. An error of the fitted camera shows in no
    other view, and is left out there.

    Args:
        base: base fit to the markers, or to the first camera.
        best: the best fit with effects.
        placebo: a fit of an effect that is not there.
        options: settings.

    Returns:
        One per view; none where the models cannot be run, or the best effects are errors of one camera or numerical.
    """
    views = _other_views(base)
    if not views or not _kept(best):
        return ()
    points = np.concatenate([view.points for view in views])
    ends = np.cumsum([0, *(len(view.points) for view in views)]).tolist()
    try:
        plain = _positions(base, None, points)
        improved = _positions(base, best, points)
        other = (placebo.label, _positions(base, placebo, points)) if placebo is not None and _kept(placebo) else None
    except ConvergenceError:
        return ()
    found = []
    for view, part in zip(views, (slice(*pair) for pair in pairwise(ends)), strict=True):
        motion = PointMotion(view.points, base.motion.times, plain[:, part], np.zeros_like(plain[:, part]))
        model = replace(base.model, points=view.points, correction=None, directions={}, camera=view.camera)
        seen = replace(base, observations=view, model=model, motion=motion, modes=undivided(view.frames))
        found.append(
            shrinkage_on(
                seen,
                ErrorModel.of_noise(len(view.frames)),
                improved[:, part],
                None if other is None else (other[0], other[1][:, part]),
                np.unique(view.frames),
                f"held-out view {view.camera.name}, all frames",
                options,
            )
        )
    return tuple(found)


def _other_views(base: Baseline) -> list[PixelObservations]:
    """Points in the videos of cameras that were not compared."""
    seen, views = base.observations, []
    fitted = seen.camera.name if isinstance(seen, PixelObservations) else None
    for camera in base.capture.cameras:
        if camera.name == fitted:
            continue
        try:
            views.append(followed(base.capture, camera, base.model.twin))
        except InputError:  # no video, or nothing to follow in it: the diagnosis does not need it
            continue
    return views


def _kept(hypothesis: Hypothesis) -> tuple[Effect, ...]:
    """Effects that another camera sees."""
    return tuple(e for e in hypothesis.effects if e.name not in _OF_ONE_CAMERA and e.source != "numerical")


def _positions(base: Baseline, hypothesis: Hypothesis | None, points: np.ndarray) -> Positions:
    """What is observed of other points [m], by the base model at its fit or at that of a hypothesis.

    Raises:
        ConvergenceError: it cannot be run.
    """
    effects, values = () if hypothesis is None else _kept(hypothesis), base.fit.values
    if hypothesis is not None:
        own = hypothesis.values[: len(hypothesis.model.base)]
        values = np.concatenate([own, *(hypothesis.doses(effect)[0] for effect in effects)])
    model = replace(base.model, points=points, effects=effects, correction=None, directions={}, camera=None)
    return model.positions(values)
