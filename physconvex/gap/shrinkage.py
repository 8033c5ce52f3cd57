"""Shrinkage of the gap: on held-out frames, in held-out views, on a second take.

Noise floor and placebo are subtracted. In held-out views, points are tracked in the videos of the other cameras. On a
second recording of the same body, only the initial motion is fitted.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import FLOOR_LAW, Baseline, Report
from physconvex.gap.base.body_modes import undivided
from physconvex.gap.base.model import MODULUS, RATIO
from physconvex.gap.base.observed_points import followed
from physconvex.gap.base.rough_fit import rough_baseline
from physconvex.gap.conditions.setting import find_setting
from physconvex.gap.effects.effect import Effect
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.errors.numerical_differences import other_mesh
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.location.sources import squares_by_frame
from physconvex.gap.location.where import block_bootstrap
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.identify import PixelObservations
from physconvex.io import Capture

Positions = Float[np.ndarray, "T P 3"]
_OF_ONE_CAMERA = ("camera_pose", "focal_length", "lens_distortion", "rolling_shutter")
_MATERIAL = (MODULUS, RATIO, *FLOOR_LAW)


@dataclass(frozen=True)
class HowFar:
    """Shrinkage of the gap.

    Attributes:
        data: data of the measurement.
        gap_before, gap_after: rms distance between model and observation [m], noise included.
        noise_floor: expected distance from noise and numerical error [m].
        shrinkage: share of the gap above the floor that the effects remove; negative if they make it worse.
        lower, upper: its interval.
        placebo: shrinkage by the lowest-ranked effect, fitted in the same way; NaN without one.
        placebo_effect: its name.
        net_shrinkage: shrinkage less that of the placebo.
    """

    data: str
    gap_before: float
    gap_after: float
    noise_floor: float
    shrinkage: float
    lower: float
    upper: float
    placebo: float
    placebo_effect: str
    net_shrinkage: float

    @property
    def above_error(self) -> float:
        """Share of the gap above noise and numerical error that the effects remove."""
        squares = np.square([self.gap_before, self.gap_after, self.noise_floor])
        return float(_share(*squares))


def _share(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """1 − (after − floor)/(before − floor) of mean squares; values below the floor count as the floor."""
    open_gap = np.maximum(before - floor, 1e-3 * np.maximum(before, 1e-300))
    return 1.0 - np.maximum(after - floor, 0.0) / open_gap


def shrinkage_on(
    base: Baseline, errors: ErrorModel, improved: Positions, *, placebo: tuple[str, Positions] | None,
    frames: np.ndarray, data: str, options: GapOptions,
) -> HowFar:  # fmt: skip
    """Shrinkage in some frames. Noise is subtracted; the reported floor includes numerical error.

    Args:
        base, errors: the observations and the base model's predictions, and errors of the residuals.
        improved: observed positions with the effects [m].
        placebo: name of another effect, and observed positions with it [m].
        frames, data: frames of the measurement, which all show something, and their name.
        options: settings.
    """

    def squares(positions: Positions) -> Float[np.ndarray, " n"]:
        return squares_by_frame(base, base.missed(positions) ** 2)[frames]

    before, after = squares(base.positions), squares(improved)
    noise, floor = (squares_by_frame(base, base.lengths**2 * size)[frames] for size in (1.0, errors.expected))
    draws = block_bootstrap(np.stack([before, after, noise], axis=1), 3, options)
    tail = (1 - options.confidence) / 2
    low, high = np.quantile(_share(draws[:, 0], draws[:, 1], draws[:, 2]), [tail, 1 - tail])
    share = float(_share(before.mean(), after.mean(), noise.mean()))
    other = float("nan")
    if placebo is not None:
        other = float(_share(before.mean(), squares(placebo[1]).mean(), noise.mean()))
    return HowFar(
        data=data,
        gap_before=float(np.sqrt(before.mean())),
        gap_after=float(np.sqrt(after.mean())),
        noise_floor=float(np.sqrt(floor.mean())),
        shrinkage=share,
        lower=float(low),
        upper=float(high),
        placebo=other,
        placebo_effect="" if placebo is None else placebo[0],
        net_shrinkage=share - (max(other, 0.0) if np.isfinite(other) else 0.0),
    )


def held_out_views(
    base: Baseline, best: Hypothesis, placebo: Hypothesis | None, options: GapOptions
) -> tuple[HowFar, ...]:
    """Shrinkage in all frames of each further camera whose video has trackable points.

    Every model runs once more for the points of the other cameras. An error of the fitted camera does not appear in
    another view and is left out there. None if the models cannot be run, or if the best effects are numerical or errors
    of one camera.
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
        found.append(shrinkage_on(
            seen, ErrorModel.of_noise(len(view.frames)), improved[:, part],
            placebo=None if other is None else (other[0], other[1][:, part]), frames=np.unique(view.frames),
            data=f"held-out view {view.camera.name}, all frames", options=options,
        ))  # fmt: skip
    return tuple(found)


def _other_views(base: Baseline) -> list[PixelObservations]:
    """Points in the videos of cameras outside the comparison."""
    seen, views = base.observations, []
    fitted = seen.camera.name if isinstance(seen, PixelObservations) else None
    for camera in base.capture.cameras:
        if camera.name != fitted:
            with suppress(InputError):  # no video, or nothing to track in it; the diagnosis does not need it
                views.append(followed(base.capture, camera, base.model.twin))
    return views


def _kept(hypothesis: Hypothesis) -> tuple[Effect, ...]:
    """Effects that another camera sees."""
    return tuple(e for e in hypothesis.effects if e.name not in _OF_ONE_CAMERA and e.source != "numerical")


def _positions(base: Baseline, hypothesis: Hypothesis | None, points: np.ndarray) -> Positions:
    """Observed positions of other points [m], by the base model at its fit or by a hypothesis.

    Raises:
        ConvergenceError: it cannot be run.
    """
    effects, values = () if hypothesis is None else _kept(hypothesis), base.fit.values
    if hypothesis is not None:
        own = hypothesis.values[: len(hypothesis.model.base)]
        values = np.concatenate([own, *(hypothesis.doses(effect)[0] for effect in effects)])
    model = replace(base.model, points=points, effects=effects, correction=None, directions={}, camera=None)
    return model.positions(values)


def second_take_shrinkage(
    base: Baseline, best: Hypothesis, take: Capture, options: GapOptions, report: Report
) -> HowFar | None:
    """Shrinkage on another take: E, ν and doses from the first, the unstated initial motion from the second's start.

    `base` and `best` are the base fit and the best fit of the first take. None if one of the two models cannot be run
    on the second.

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
        material = _with_material(own, best.values, best.model.base).fit.values
        values = np.concatenate([material, *(best.doses(effect)[0] for effect in best.effects)])
        model = replace(own.model, effects=best.effects)
        plain = replace(plain, motion=plain.model.motion(plain.fit.values))
        improved = model.positions(values)
    except ConvergenceError:
        return None
    errors = ErrorModel.of_noise(len(plain.residual(plain.positions)))
    frames = np.unique(plain.observations.frames)
    return shrinkage_on(
        plain, errors, improved, placebo=None, frames=frames, data="second take, all frames", options=options
    )


def _as_fine(own: Baseline, first: Baseline, options: GapOptions) -> Baseline:
    """The second take's model on a mesh as fine as the first one's; a coarser one is stiffer."""
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
