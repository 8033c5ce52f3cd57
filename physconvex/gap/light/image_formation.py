"""Effects of image formation: drifting exposure, open shutter.

They move no point, so they are tested apart from the motion. Two statistics of each picture are compared with the first
one. The first is the logarithm of the light of the still background. The second, of the body's patches, is the
logarithm of the energy of gradients along the motion over that across it. A smear along the motion lowers it; defocus,
a lossy codec or a patch that is a pixel off do not change it. Each effect, applied to patches of the first picture,
predicts one of the two. Its dose is fitted to every other frame and tested on the frames between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.effects.effect import Effect, Patches, Situation
from physconvex.gap.judgement.naming import NamedDose, NamedEffect, Verdict
from physconvex.gap.light.patches import HALF, Compared, body_patches, light_of, still_patches
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import PICTURES, VERDICT
from physconvex.identify import PixelObservations, cast_camera_rays

Feature = Callable[[Float[np.ndarray, "N h w"], Patches], Float[np.ndarray, " N"]]
_TINY = 1e-9


@dataclass(frozen=True)
class Statistic:
    """A number per patch: name, function from light [N, h, w] and patches to numbers [N], error without an effect."""

    name: str
    of: Feature
    floor: float


@dataclass(frozen=True, eq=False)
class Series:
    """A statistic of the pictures, frame by frame, and its prediction by an effect.

    Attributes:
        frames: shape [n].
        seen: medians over the patches of a frame, relative to the first picture, shape [n].
        errors: their standard errors, shape [n].
        doses: trial doses of the effect, shape [K].
        foretold: predicted statistic at these doses, shape [K, n].
    """

    frames: Int[np.ndarray, " n"]
    seen: Float[np.ndarray, " n"]
    errors: Float[np.ndarray, " n"]
    doses: Float[np.ndarray, " K"]
    foretold: Float[np.ndarray, "K n"]

    def at(self, dose: float) -> Float[np.ndarray, " n"]:
        """The predicted statistic at a dose."""
        return np.asarray(PchipInterpolator(self.doses, self.foretold)(dose))

    def missed(self, dose: float) -> float:
        """Mean square of the observed less the predicted statistic."""
        return float(((self.seen - self.at(dose)) ** 2).mean())

    def every_other(self, first: int) -> Series:
        """Every other frame from the first one or the next."""
        part = slice(first, None, 2)
        return Series(self.frames[part], self.seen[part], self.errors[part], self.doses, self.foretold[:, part])


@dataclass(frozen=True, eq=False)
class ImageFinding:
    """Result of the pictures for one effect.

    Attributes:
        named: the effect with probability, dose and interval.
        called: whether it is a cause.
        statistic: name of the compared statistic, for people.
        gap_before, gap_after, noise_floor: rms of the statistic (a logarithm) in held-out frames.
        shrinkage: share of the gap above the floor that the effect removes there.
        placebo: the same by an effect of the wrong direction; NaN without one.
        series: the observed statistic.
    """

    named: NamedEffect
    called: bool
    statistic: str
    gap_before: float
    gap_after: float
    noise_floor: float
    shrinkage: float
    placebo: float
    series: Series

    @property
    def sentence(self) -> str:
        """The result in words."""
        dose = self.named.doses[0]
        return (
            f"The pictures show {self.named.name} (probability {self.named.probability:.0%}): {dose.name} = "
            f"{dose.value:.3g} {dose.unit}, which moves no point."
        )


def image_findings(base: Baseline, effects: Sequence[Effect], options: GapOptions) -> tuple[ImageFinding, ...]:
    """Results for effects of image formation; none if markers are compared."""
    seen = base.observations
    tried = [effect for effect in effects if effect.photograph is not None and effect.applies(base.situation)]
    if not tried or not isinstance(seen, PixelObservations):
        return ()
    fps = base.capture.fps
    light = light_of(base.capture.video(seen.camera.name).frames[: base.model.frames])
    outline = cast_camera_rays(seen.camera, *base.model.twin.surface).faces >= 0
    still, moving = still_patches(light, seen, fps, outline), body_patches(light, seen, fps, outline)
    found = [
        finding_of(effect, base.situation, statistic, compared, options)
        for effect in tried
        for statistic, compared in ((BRIGHTNESS, still), (SMEAR, moving))
    ]
    return tuple(finding for finding in found if finding is not None)


def with_pictures(verdict: Verdict, findings: Sequence[ImageFinding]) -> Verdict:
    """The verdict on the motion, extended by the result of the pictures.

    An effect of the pictures is a separate cause. An open verdict on the motion stays open.
    """
    called = [finding for finding in findings if finding.called]
    if not called:
        return verdict
    named, told = tuple(finding.named for finding in called), " ".join(finding.sentence for finding in called)
    if verdict.name == "none":
        return replace(verdict, name="effect", sentence=f"{told} Of the motion: {verdict.sentence}", effects=named)
    effects = (*verdict.effects, *named)
    if verdict.name == "effect":
        return replace(verdict, sentence=f"{verdict.sentence} {told}", effects=effects)
    return replace(verdict, effects=effects, caveats=(told, *verdict.caveats))


def finding_of(
    effect: Effect, situation: Situation, statistic: Statistic, compared: Compared, options: GapOptions
) -> ImageFinding | None:
    """Result of one statistic for one effect; None if the effect does not show in it, or data are too few."""
    series = series_of(effect, situation, statistic, compared)
    if series is None:
        return None
    first, fitted, judging = effect.doses[0], series.every_other(0), series.every_other(1)
    dose, error, gain = fit_series(fitted, first.null)
    width = error * float(norm.ppf(0.5 + options.confidence / 2))
    before, after, floor = judging.missed(first.null), judging.missed(dose), float((judging.errors**2).mean())
    share = _share(before, after, floor)
    placebo = _placebo(effect, situation, statistic, compared, before=before, floor=floor)
    called = (
        gain >= PICTURES.clear
        and abs(dose - first.null) >= first.smallest
        and share >= options.explained
        and not placebo > PICTURES.placebo * share
    )
    named = NamedEffect(
        effect.name, effect.variant, effect.source, VERDICT.trusted / (1 + float(np.exp(-gain))),
        (NamedDose.within(first, dose, width),), (),
    )  # fmt: skip
    return ImageFinding(
        named, called, statistic.name, gap_before=float(np.sqrt(before)), gap_after=float(np.sqrt(after)),
        noise_floor=float(np.sqrt(floor)), shrinkage=share, placebo=placebo, series=series,
    )  # fmt: skip


def series_of(
    effect: Effect, situation: Situation, statistic: Statistic, compared: Compared, *, across: bool = False
) -> Series | None:
    """The statistic in all frames with enough patches, observed and predicted at a row of doses.

    Args:
        effect: with `photograph`.
        situation: sets the range of doses: twice the trial one to both sides, within the bounds.
        statistic: the compared statistic.
        compared: the patches.
        across: whether to turn the motion by a right angle (a placebo).
    """
    assert effect.photograph is not None
    dose, trial = effect.doses[0], 2 * effect.doses[0].trial(situation)
    doses = np.linspace(max(dose.lower, dose.null - trial), min(dose.upper, dose.null + trial), PICTURES.doses)
    frames, counts = np.unique(compared.frames, return_counts=True)
    frames = frames[counts >= PICTURES.fewest_patches]
    if len(frames) < PICTURES.fewest_frames:
        return None
    sharp = compared.sharp
    turned = Patches(sharp.light, sharp.velocities[:, ::-1] * [-1, 1], sharp.times) if across else sharp
    plain = statistic.of(_middle(sharp.light), sharp)
    seen = statistic.of(compared.seen, sharp) - plain
    others = np.tile(effect.null, (PICTURES.doses, 1))
    others[:, 0] = doses
    foretold = [statistic.of(_middle(effect.photograph(turned, row)), sharp) - plain for row in others]
    per_frame = [np.flatnonzero(compared.frames == frame) for frame in frames]
    medians = np.array([[np.median(values[rows]) for rows in per_frame] for values in foretold])
    if np.ptp(medians, axis=0).max() < statistic.floor:
        return None
    middle = np.array([np.median(seen[rows]) for rows in per_frame])
    errors = np.hypot([_median_error(seen[rows]) for rows in per_frame], statistic.floor)
    return Series(frames, middle, errors, doses, medians)


def fit_series(series: Series, null: float) -> tuple[float, float, float]:
    """Dose, its standard error, and its gain of log-likelihood over `null`, less half of ln n for the dose.

    Scatter beyond the stated errors widens them all.
    """

    def square(dose: float) -> float:
        return float((((series.seen - series.at(dose)) / series.errors) ** 2).sum())

    values = [square(dose) for dose in series.doses]
    best = int(np.argmin(values))
    low, high = series.doses[max(best - 1, 0)], series.doses[min(best + 1, len(series.doses) - 1)]
    dose = float(minimize_scalar(square, bounds=(low, high), method="bounded").x)
    scatter = max(1.0, square(dose) / max(len(series.frames) - 1, 1))
    step = 0.1 * (series.doses[1] - series.doses[0])
    ahead, behind = min(dose + step, series.doses[-1]), max(dose - step, series.doses[0])
    slope = (series.at(ahead) - series.at(behind)) / (ahead - behind) / series.errors
    error = float(np.sqrt(scatter / max(slope @ slope, 1e-300)))
    return dose, error, 0.5 * (square(null) - square(dose)) / scatter - 0.5 * float(np.log(len(series.frames)))


def _placebo(
    effect: Effect, situation: Situation, statistic: Statistic, compared: Compared, *, before: float, floor: float
) -> float:
    """Share that the effect removes with the motion turned by a right angle; NaN without motion."""
    if not compared.sharp.velocities.any():
        return float("nan")
    series = series_of(effect, situation, statistic, compared, across=True)
    if series is None:
        return 0.0
    dose, _, _ = fit_series(series.every_other(0), effect.doses[0].null)
    return _share(before, series.every_other(1).missed(dose), floor)


def _share(before: float, after: float, floor: float) -> float:
    """Share of the squares above the floor; zero if there are none."""
    return 1.0 - max(after - floor, 0.0) / (before - floor) if before > floor else 0.0


def _middle(light: Float[np.ndarray, "N H W"]) -> Float[np.ndarray, "N h w"]:
    """The light without the margin."""
    middle = light.shape[1] // 2
    side = slice(middle - HALF, middle + HALF + 1)
    return np.asarray(light[:, side, side])


def _median_error(values: Float[np.ndarray, " n"]) -> float:
    """Standard error of a median, from the median deviation."""
    return float(1.25 * 1.48 * np.median(np.abs(values - np.median(values))) / np.sqrt(len(values)))


def _brightness(light: Float[np.ndarray, "N h w"], patches: Patches) -> Float[np.ndarray, " N"]:
    return np.asarray(np.log(light.mean((1, 2)) + _TINY))


def _smear(light: Float[np.ndarray, "N h w"], patches: Patches) -> Float[np.ndarray, " N"]:
    down, right = np.gradient(light, axis=(1, 2))
    way = patches.velocities / np.maximum(np.linalg.norm(patches.velocities, axis=1, keepdims=True), _TINY)
    x, y = way[:, 0, None, None], way[:, 1, None, None]
    along, across = (right * x + down * y) ** 2, (down * x - right * y) ** 2
    return np.asarray(np.log((along.mean((1, 2)) + _TINY) / (across.mean((1, 2)) + _TINY)))


BRIGHTNESS = Statistic("light of the background, logarithm", _brightness, PICTURES.brightness_error)
SMEAR = Statistic("gradients along over across the motion, logarithm", _smear, PICTURES.smear_error)
