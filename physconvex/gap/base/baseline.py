"""A fitted base model: observations, split into fitted and held-out frames, weights of residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import InputError
from physconvex.gap.base.body_modes import BodyModes, TurnedObservations
from physconvex.gap.base.model import EffectModel
from physconvex.gap.base.observed_points import Seen, components, in_metres, widened
from physconvex.gap.effects.effect import Situation
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.thresholds import BASE_FIT
from physconvex.identify import Fit, Observations, Twin
from physconvex.io import Boundary, Capture, Tracks

Report = Callable[[str], None]
# added to the base parameters if the floor gives way
FLOOR_LAW: tuple[str, str] = ("log10_contact_stiffness", "contact_damping")


@dataclass(frozen=True, eq=False)
class Split:
    """Frames for the fit, for the choice between effects, and for the reported shrinkage."""

    fitted: Int[np.ndarray, " f"]
    selecting: Int[np.ndarray, " s"]
    reporting: Int[np.ndarray, " r"]

    @property
    def end(self) -> int:
        """Number of frames up to the last fitted one."""
        return int(self.fitted[-1]) + 1

    @property
    def held_out(self) -> Int[np.ndarray, " h"]:
        """Held-out frames."""
        return np.concatenate([self.selecting, self.reporting])


@dataclass(frozen=True, eq=False)
class Baseline:
    """A fitted base model.

    Attributes:
        capture: the capture.
        observations: observations in all frames.
        split: use of the frames.
        model: the full-order model; it has effects only if a search continues from a fit.
        fit: fit of the model to the fitted frames.
        motion: motion of the observed points at the fit, all frames.
        tangents: derivatives of the observed points by the parameters, in all or the first frames, shape [f, K, P, 3].
        situation: situation of the capture.
        contact_force: total normal force at each frame [N], shape [T].
        modes: transformation of the residuals.
    """

    capture: Capture
    observations: Seen
    split: Split
    model: EffectModel
    fit: Fit
    motion: PointMotion
    tangents: Float[np.ndarray, "f K P 3"]
    situation: Situation
    contact_force: Float[np.ndarray, " T"]
    modes: BodyModes

    @property
    def positions(self) -> Float[np.ndarray, "T P 3"]:
        """Observed positions that the base model predicts [m]."""
        return self.model.observed(self.motion, self.fit.values)

    @property
    def first_contact(self) -> int | None:
        """The first frame with contact; None without contact."""
        touching = np.flatnonzero(self.contact_force > 0)
        return int(touching[0]) if len(touching) else None

    @property
    def twin(self) -> Twin:
        """The twin with the fitted values."""
        return self.model.twin.with_values(self.model.base, self.fit.values[: len(self.model.base)])

    @property
    def components(self) -> int:
        """Residuals per point and frame."""
        return components(self.observations)

    @property
    def columns(self) -> Int[np.ndarray, " N"]:
        """Index of each residual within its frame: point and coordinate, or a number if they are transformed."""
        seen = self.observations
        if not self.modes.reflections:
            return np.asarray(seen.point_indices * self.components + np.arange(len(seen.frames)) % self.components)
        first = np.searchsorted(seen.frames, seen.frames)
        return np.asarray(np.arange(len(first)) - first)

    @property
    def lengths(self) -> Float[np.ndarray, " N"]:
        """Length that one standard deviation of each residual by point stands for [m], shape [N]."""
        return in_metres(self.observations, self.motion)

    def rows(self, frames: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
        """Residuals of some frames."""
        return np.flatnonzero(np.isin(self.observations.frames, frames))

    def residual(self, positions: Float[np.ndarray, "T P 3"]) -> Float[np.ndarray, " N"]:
        """Seen − model, in units of the stated noise, transformed, all frames."""
        return self.modes.turn(-self.observations.residuals(positions))

    def missed(self, positions: Float[np.ndarray, "T P 3"]) -> Float[np.ndarray, " N"]:
        """Seen − model [m], point by point, all frames."""
        return np.asarray(-self.observations.residuals(positions) * self.lengths)

    def change(self, positions: Float[np.ndarray, "T P 3"]) -> Float[np.ndarray, " N"]:
        """Change of the residual when the base motion moves to `positions`, in all frames or the first ones."""
        if len(positions) < self.model.frames:
            positions = np.concatenate([positions, self.positions[len(positions) :]])
        return self.modes.turn(self.observations.residuals(positions) - self.observations.residuals(self.positions))

    def weighted(self, variance: Float[np.ndarray, " N"], count: int) -> Observations:
        """Observations of the first frames, with the noise of each residual widened."""
        if not self.modes.reflections:
            return widened(self.observations, variance).in_frames(count)
        return TurnedObservations(self.observations, self.modes, np.sqrt(variance)).in_frames(count)


def derivatives_of_residuals(
    base: Baseline, positions: Float[np.ndarray, "f P 3"], tangents: Float[np.ndarray, "f K P 3"]
) -> Float[np.ndarray, "K N"]:
    """Change of the residuals per unit of each value, from its derivative of the positions in the first f frames."""
    return np.stack([base.change(positions + 1e-3 * d) / 1e-3 for d in np.moveaxis(tangents, 1, 0)])


def split_frames(capture: Capture, seen: Int[np.ndarray, " n"]) -> Split:
    """Fit the observed frames, or the first two thirds if all are observed; half of the rest selects, half reports.

    Raises:
        InputError: fewer than six frames are seen.
    """
    frames = np.unique(seen)
    if len(frames) < BASE_FIT.fewest_frames:
        raise InputError(
            f"{capture.folder}: points are seen in {len(frames)} frames; a diagnosis needs at least "
            f"{BASE_FIT.fewest_frames}"
        )
    first = frames[frames < capture.observed_frames]
    rest = frames[frames >= capture.observed_frames]
    if len(rest) < 2 or len(first) < 4:
        cut = max(4, (2 * len(frames)) // 3)
        first, rest = frames[:cut], frames[cut:]
    half = (len(rest) + 1) // 2
    return Split(first, rest[:half], rest[half:] if len(rest) > half else rest[-1:])


@dataclass(frozen=True, eq=False)
class _Beginning(Capture):
    """A capture that is cut to its first `frames` frames.

    Attributes:
        whole: the uncut capture.
    """

    whole: Capture | None = None

    def tracks(self) -> Tracks | None:
        """Marker tracks of the first frames."""
        assert self.whole is not None
        tracks = self.whole.tracks()
        if tracks is None:
            return None
        return replace(tracks, positions=tracks.positions[: self.frames], sigma=tracks.sigma[: self.frames])

    def boundary(self) -> Boundary | None:
        """Held parts and their motion in the first frames."""
        assert self.whole is not None
        boundary = self.whole.boundary()
        if boundary is None or boundary.motion is None:
            return boundary
        return replace(boundary, motion=boundary.motion[: self.frames])


def shortened(capture: Capture, most: int = BASE_FIT.most_frames) -> Capture:
    """A capture cut to a number of frames, with the same observed share, two thirds at most.

    A diagnosis simulates a capture some hundred times, and open-loop models diverge from long recordings.
    """
    if capture.frames <= most:
        return capture
    stated = {field.name: getattr(capture, field.name) for field in fields(Capture) if field.init}
    stated |= {"frames": most, "observed_frames": min(capture.observed_frames, 2 * most // 3)}
    return _Beginning(**stated, whole=capture)
