"""Observations of a motion as whitened residuals of material points: one interface for markers, pixels, outlines.

An observation names the material points it needs (`points`, rest positions). From the model's positions of these it
computes (model − seen)/σ, a fixed number N of residuals, and their derivatives. Every residual has a frame and a point.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from physconvex.errors import ConvergenceError, InputError
from physconvex.identify.point_models import PointModel, Positions, Tangents, Values
from physconvex.io import Camera
from physconvex.numerics import huber_loss

Residuals = Float[np.ndarray, " N"]
Jacobian = Float[np.ndarray, "N K"]


@runtime_checkable
class Observations(Protocol):
    """Anything that can be compared with a model's positions."""

    @property
    def points(self) -> Float[np.ndarray, "P 3"]:
        """Rest positions of the observed material points [m]."""

    @property
    def frames(self) -> Int[np.ndarray, " N"]:
        """Frame of each residual."""

    @property
    def point_indices(self) -> Int[np.ndarray, " N"]:
        """Point of each residual, an index into `points`."""

    @property
    def robust_scales(self) -> Float[np.ndarray, " N"]:
        """Residual above which Huber's loss is linear, in standard deviations; inf: least squares."""

    def residuals(self, positions: Positions) -> Residuals:
        """(model − seen)/σ for the model's positions [T, P, 3] m of the points, all frames."""

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """The residuals, and their derivatives by K parameters where the positions have `tangents` [T, K, P, 3]."""

    def in_frames(self, count: int) -> Observations:
        """The first `count` frames alone; the points stay."""


class PointwiseObservations:
    """Base of observations in which each visible point has as many residuals as coordinates.

    A subclass defines `robust_scale`, `seen` (which points are seen in which frame, [T, P]) and `width` (the number of
    residuals of each).
    """

    robust_scale: float
    width: ClassVar[int]

    @property
    def seen(self) -> Bool[np.ndarray, "T P"]:
        """Which points are seen in which frame."""
        raise NotImplementedError

    @cached_property
    def pairs(self) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Frames and points of the visible ones."""
        frames, points = np.nonzero(self.seen)
        return frames, points

    @cached_property
    def frames(self) -> Int[np.ndarray, " N"]:
        """Frame of each residual."""
        return np.repeat(self.pairs[0], self.width)

    @cached_property
    def point_indices(self) -> Int[np.ndarray, " N"]:
        """Point of each residual."""
        return np.repeat(self.pairs[1], self.width)

    @property
    def axes(self) -> Int[np.ndarray, " N"]:
        """Coordinate of each residual: of space, of the image (0 along the columns, 1 along the rows), or of colour."""
        return np.tile(np.arange(self.width), len(self.pairs[0]))

    @property
    def robust_scales(self) -> Float[np.ndarray, " N"]:
        """Huber's thresholds."""
        return np.full(len(self.frames), self.robust_scale)


class EvaluatedObservations:
    """Observations with one function for residuals and derivatives, which skips derivatives that are not needed."""

    def _evaluate(self, positions: np.ndarray, tangents: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Residuals [N], and derivatives [N, K]; K = 0 without tangents."""
        raise NotImplementedError

    def residuals(self, positions: Positions) -> Residuals:
        """(model − seen)/σ."""
        return self._evaluate(positions, None)[0]

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """The residuals and their derivatives."""
        return self._evaluate(positions, tangents)


@dataclass(frozen=True, eq=False)
class WrappedObservations:
    """Observations with changed residuals and derivatives; the rest is that of `seen`.

    Attributes:
        seen: the observations.
    """

    seen: Observations

    @property
    def points(self) -> Float[np.ndarray, "P 3"]:
        """Rest positions of the material points [m]."""
        return self.seen.points

    @property
    def frames(self) -> Int[np.ndarray, " N"]:
        """Frame of each residual."""
        return self.seen.frames

    @property
    def point_indices(self) -> Int[np.ndarray, " N"]:
        """Point of each residual."""
        return self.seen.point_indices

    @property
    def robust_scales(self) -> Float[np.ndarray, " N"]:
        """Huber's thresholds."""
        return self.seen.robust_scales


class _Followed(PointwiseObservations):
    """Base of points followed in space or in images."""

    points: Float[np.ndarray, "P 3"]
    sigma: Float[np.ndarray, "T P"]

    def _check(self, kind: str, name: str, measured: np.ndarray) -> None:
        shape = np.shape(measured)
        if len(shape) != 3 or shape[1:] != (len(self.points), self.width) or np.shape(self.sigma) != shape[:2]:
            raise InputError(
                f"{kind}: got points {np.shape(self.points)}, {name} {shape} and sigma {np.shape(self.sigma)}; "
                f"expected [P, 3], [T, P, {self.width}] and [T, P]"
            )


@dataclass(frozen=True, eq=False)
class MarkerObservations(_Followed):
    """Points followed in space.

    Attributes:
        points: rest positions [m], shape [P, 3].
        positions: measured positions [m], shape [T, P, 3]; NaN = not seen.
        sigma: standard deviation of each coordinate [m], shape [T, P].
        robust_scale: Huber's threshold in standard deviations; inf = least squares.

    Raises:
        InputError: shapes that do not fit, or nothing seen.
    """

    points: Float[np.ndarray, "P 3"]
    positions: Float[np.ndarray, "T P 3"]
    sigma: Float[np.ndarray, "T P"]
    robust_scale: float = np.inf
    width: ClassVar[int] = 3

    def __post_init__(self) -> None:
        self._check("markers", "positions", self.positions)
        if not len(self.frames):
            raise InputError("markers: none is seen in any frame; expected at least one position that is not NaN")

    @property
    def seen(self) -> Bool[np.ndarray, "T P"]:
        """Which points are seen in which frame."""
        return np.isfinite(self.positions).all(-1)

    def residuals(self, positions: Positions) -> Residuals:
        """(model − seen)/σ."""
        t, p = self.pairs
        return ((positions[t, p] - self.positions[t, p]) / self.sigma[t, p][:, None]).ravel()

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """The residuals and their derivatives."""
        t, p = self.pairs
        jacobian = tangents[t, :, p] / self.sigma[t, p][:, None, None]  # [n, K, 3]
        return self.residuals(positions), np.moveaxis(jacobian, 1, 2).reshape(-1, tangents.shape[1])

    def in_frames(self, count: int) -> MarkerObservations:
        """The first `count` frames alone."""
        return MarkerObservations(self.points, self.positions[:count], self.sigma[:count], self.robust_scale)


def camera_jacobian(camera: Camera, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
    """Derivatives of a camera's pixel coordinates by world positions [pixels/m]; NaN behind the camera."""
    local = camera.local(points)
    depth = np.where(local[:, 2] < 0, -local[:, 2], np.nan)
    plane = np.stack([local[:, 0] / depth, -local[:, 1] / depth], axis=-1)
    rate, zero = 1 / depth, np.zeros_like(depth)
    rows = [rate, zero, plane[:, 0] / depth], [zero, -rate, plane[:, 1] / depth]
    by_local = np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
    square = (plane**2).sum(-1)
    slope = camera.k1 + 2 * camera.k2 * square  # of the distortion by r²
    spread = camera.distortion(square)[:, None, None] * np.eye(2)
    spread = spread + 2 * slope[:, None, None] * plane[:, :, None] * plane[:, None, :]
    focal = np.array([camera.fl_x, camera.fl_y])[:, None]
    return focal * (spread @ by_local) @ camera.rotation.T


@dataclass(frozen=True, eq=False)
class PixelObservations(_Followed):
    """Material points followed in the images of one camera.

    Attributes:
        camera: the camera.
        points: rest positions [m], shape [P, 3].
        pixels: measured pixel coordinates, shape [T, P, 2]; NaN = not seen.
        sigma: standard deviation of each coordinate [pixels], shape [T, P].
        robust_scale: Huber's threshold in standard deviations.

    Raises:
        InputError: shapes that do not fit, or nothing seen.
    """

    camera: Camera
    points: Float[np.ndarray, "P 3"]
    pixels: Float[np.ndarray, "T P 2"]
    sigma: Float[np.ndarray, "T P"]
    robust_scale: float = 3.0
    width: ClassVar[int] = 2

    def __post_init__(self) -> None:
        self._check("pixels", "pixels", self.pixels)
        if not len(self.frames):
            raise InputError(
                f"pixels: camera {self.camera.name!r} sees no point in any frame; expected at least one that is not NaN"
            )

    @property
    def seen(self) -> Bool[np.ndarray, "T P"]:
        """Which points are seen in which frame."""
        return np.isfinite(self.pixels).all(-1)

    def residuals(self, positions: Positions) -> Residuals:
        """(model − seen)/σ; a point that the model puts behind the camera has a residual of 1e3."""
        t, p = self.pairs
        pixels, _ = self.camera.project(positions[t, p])
        values = (pixels - self.pixels[t, p]) / self.sigma[t, p][:, None]
        return np.nan_to_num(values, nan=1e3).ravel()

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """The residuals and their derivatives."""
        t, p = self.pairs
        by_position = np.nan_to_num(camera_jacobian(self.camera, positions[t, p])) / self.sigma[t, p][:, None, None]
        jacobian = np.einsum("nci,nki->nck", by_position, tangents[t, :, p])
        return self.residuals(positions), jacobian.reshape(-1, tangents.shape[1])

    def in_frames(self, count: int) -> PixelObservations:
        """The first `count` frames alone."""
        return PixelObservations(self.camera, self.points, self.pixels[:count], self.sigma[:count], self.robust_scale)


@dataclass(frozen=True, eq=False)
class StackedObservations:
    """Several observations as one: their points and their residuals one after the other."""

    parts: tuple[Observations, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise InputError("observations: got none; expected marker tracks, videos or masks")

    @classmethod
    def of(cls, parts: Sequence[Observations]) -> StackedObservations:
        """The stack of several; nested stacks are flattened."""
        flat: list[Observations] = []
        for part in parts:
            flat.extend(part.parts if isinstance(part, StackedObservations) else [part])
        return cls(tuple(flat))

    @cached_property
    def points(self) -> Float[np.ndarray, "P 3"]:
        """All points [m]."""
        return np.concatenate([part.points for part in self.parts])

    @cached_property
    def point_slices(self) -> tuple[slice, ...]:
        """Slice of each part's points."""
        return _slices(len(part.points) for part in self.parts)

    @cached_property
    def residual_slices(self) -> tuple[slice, ...]:
        """Slice of each part's residuals."""
        return _slices(len(part.frames) for part in self.parts)

    @property
    def stated(self) -> tuple[bool, ...]:
        """Whether the recording states the noise of each part (it does for markers)."""
        return tuple(isinstance(part, MarkerObservations) for part in self.parts)

    @cached_property
    def frames(self) -> Int[np.ndarray, " N"]:
        """Frame of each residual."""
        return np.concatenate([part.frames for part in self.parts])

    @cached_property
    def point_indices(self) -> Int[np.ndarray, " N"]:
        """Point of each residual, an index into `points` of the stack."""
        pairs = zip(self.parts, self.point_slices, strict=True)
        return np.concatenate([part.point_indices + where.start for part, where in pairs])

    @property
    def robust_scales(self) -> Float[np.ndarray, " N"]:
        """Huber's thresholds."""
        return np.concatenate([part.robust_scales for part in self.parts])

    def in_frames(self, count: int) -> StackedObservations:
        """The first `count` frames alone; the points stay."""
        return StackedObservations(tuple(part.in_frames(count) for part in self.parts))

    def residuals(self, positions: Positions) -> Residuals:
        """(model − seen)/σ."""
        pairs = zip(self.parts, self.point_slices, strict=True)
        return np.concatenate([part.residuals(positions[:, where]) for part, where in pairs])

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """The residuals and their derivatives."""
        pairs = zip(self.parts, self.point_slices, strict=True)
        found = [part.linearise(positions[:, where], tangents[:, :, where]) for part, where in pairs]
        return np.concatenate([r for r, _ in found]), np.concatenate([j for _, j in found])


def _slices(lengths: Iterable[int]) -> tuple[slice, ...]:
    """Slices of these lengths, one after the other."""
    return tuple(slice(a, b) for a, b in pairwise(accumulate(lengths, initial=0)))


def misfit_of(observations: Observations, positions: Positions) -> float:
    """Half the sum of squared residuals, with Huber's loss for large ones; without priors."""
    return huber_loss(observations.residuals(positions), observations.robust_scales)


def model_misfit(model: PointModel, observations: Observations, values: Values) -> float:
    """Misfit of a model; infinite where it fails."""
    try:
        return misfit_of(observations, model.positions(values))
    except ConvergenceError:
        return np.inf
