"""Eliminates errors of the observation (camera pose, time offset), with Gaussian priors.

r are the whitened residuals and N their derivatives by the nuisances c ~ N(0, Σ). To first order, fitting c together
with the other parameters equals whitening r by its covariance with c included,

    r̃ = (I + N Σ Nᵀ)^(−1/2) r.

Estimates and intervals then include the nuisances, and the number of unknowns stays the same. The nuisances follow as ĉ
= −Σ Nᵀ (I + N Σ Nᵀ)⁻¹ r.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from physconvex.identify.colours import ColourObservations
from physconvex.identify.observations import (
    Jacobian,
    Observations,
    PixelObservations,
    Residuals,
    StackedObservations,
    WrappedObservations,
)
from physconvex.identify.point_models import Positions, Tangents
from physconvex.io import Camera, CommandLine, Options

_Deviation = Annotated[float, Field(ge=0), CommandLine(panel="What was observed")]


class Nuisance(Options):
    """Standard deviations of the priors; 0 holds a nuisance at zero."""

    camera_rotation: _Deviation = 0.0
    """Fit the rotation of each camera about its axes, with this prior standard deviation [rad]; 0 holds it."""
    camera_position: _Deviation = 0.0
    """Fit the position of each camera, with this prior standard deviation [m]; 0 holds it."""
    time_offset: _Deviation = 0.0
    """Fit a common time offset of all frames after the first, with this prior standard deviation [s]; 0 holds it."""

    @property
    def any(self) -> bool:
        """Whether any nuisance is free."""
        return max(self.camera_rotation, self.camera_position, self.time_offset) > 0


@dataclass(frozen=True, eq=False)
class Elimination:
    """(I + N Nᵀ)^(−½) = I + N K Nᵀ and its determinant, from the Gram matrix Nᵀ N alone, which is small.

    Attributes:
        inner: K, shape [C, C].
        eigenvalues: of the Gram matrix, shape [C].
    """

    inner: Float[np.ndarray, "C C"]
    eigenvalues: Float[np.ndarray, " C"]

    @classmethod
    def of(cls, gram: Float[np.ndarray, "C C"]) -> Elimination:
        """For unknowns with unit variance; the columns of N are the residuals' derivatives by them."""
        values, vectors = np.linalg.eigh(gram)
        root = np.sqrt(1 + np.maximum(values, 0.0))
        return cls(-(vectors / (root * (1 + root))) @ vectors.T, np.maximum(values, 0.0))

    @property
    def log_determinant(self) -> float:
        """log det(I + N Nᵀ)."""
        return float(np.log1p(self.eigenvalues).sum())


@dataclass(frozen=True, eq=False)
class MarginalObservations(WrappedObservations):
    """Observations with their nuisances eliminated.

    Attributes:
        seen: the observations.
        nuisance: the priors.
        interval: time between frames [s].
    """

    seen: StackedObservations
    nuisance: Nuisance
    interval: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nuisances, with their units."""
        names = ["time_offset [s]"] if self.nuisance.time_offset else []
        for part in self.seen.parts:
            if (camera := getattr(part, "camera", None)) is not None:
                names += [f"{camera.name}/{name}" for _, name, _ in self._camera_nuisances()]
        return tuple(dict.fromkeys(names))

    def _camera_nuisances(self) -> list[tuple[int, str, float]]:
        """Column of `_camera_columns`, name and prior of each free nuisance of a camera."""
        rotation, position = self.nuisance.camera_rotation, self.nuisance.camera_position
        every = [(f"rotation_{axis} [rad]", rotation) for axis in "xyz"]
        every += [(f"position_{axis} [m]", position) for axis in "xyz"]
        return [(column, name, sigma) for column, (name, sigma) in enumerate(every) if sigma]

    def in_frames(self, count: int) -> MarginalObservations:
        """The first `count` frames alone."""
        return MarginalObservations(self.seen.in_frames(count), self.nuisance, self.interval)

    def residuals(self, positions: Positions) -> Residuals:
        """Whitened residuals."""
        return self._whitened(self.seen.residuals(positions)[:, None], positions)[:, 0]

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """Whitened residuals and their derivatives (the derivatives by the nuisances held fixed)."""
        residuals, jacobian = self.seen.linearise(positions, tangents)
        both = self._whitened(np.hstack([residuals[:, None], jacobian]), positions)
        return both[:, 0], both[:, 1:]

    def estimates(self, positions: Positions) -> dict[str, float]:
        """Estimates of the nuisances, by name."""
        scaled, sigmas = self._directions(positions)
        inner = np.eye(scaled.shape[1]) + scaled.T @ scaled
        found = -sigmas * np.linalg.solve(inner, scaled.T @ self.seen.residuals(positions))
        return dict(zip(self.names, map(float, found), strict=True))

    def _whitened(self, columns: np.ndarray, positions: np.ndarray) -> np.ndarray:
        directions, _ = self._directions(positions)
        inner = Elimination.of(directions.T @ directions).inner
        return np.asarray(columns + directions @ (inner @ (directions.T @ columns)))

    def _directions(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """N Σ^½ [N, C], and Σ^½ [C]."""
        names = self.names
        out, sigmas = np.zeros((len(self.frames), len(names))), np.zeros(len(names))
        if self.nuisance.time_offset:
            out[:, 0] = self.seen.linearise(positions, self._velocities(positions)[:, None])[1][:, 0]
            sigmas[0] = self.nuisance.time_offset
        for part, where, rows in zip(self.seen.parts, self.seen.point_slices, self.seen.residual_slices, strict=True):
            camera = getattr(part, "camera", None)
            if camera is None or not self._camera_nuisances():
                continue
            turned = _camera_columns(part, positions[:, where], camera)
            for column, name, sigma in self._camera_nuisances():
                place = names.index(f"{camera.name}/{name}")
                out[rows, place], sigmas[place] = turned[:, column], sigma
        return out * sigmas, sigmas

    def _velocities(self, positions: np.ndarray) -> np.ndarray:
        """ẋ [m/s]; zero in the first frame, which is the state at t = 0 by definition."""
        speed = np.gradient(positions, self.interval, axis=0) if len(positions) > 1 else np.zeros_like(positions)
        speed[0] = 0.0
        return np.asarray(speed)


def _camera_columns(part: Observations, positions: np.ndarray, camera: Camera) -> np.ndarray:
    """Derivatives of a part's residuals by the pose of its camera [N, 6]: the world moves the opposite way.

    A ray of the first image places the followed points on the surface, so that they move with the pose: their pixels in
    the first image never change, and only the difference to the first frame remains.
    """
    axes = camera.rotation.T
    arms = positions - camera.position
    moves = np.stack([*(np.cross(arms, axis) for axis in axes), *(np.broadcast_to(-axis, arms.shape) for axis in axes)])
    tangents = np.moveaxis(moves, 0, 1)
    if isinstance(part, PixelObservations | ColourObservations):
        tangents = tangents - tangents[:1]
    return part.linearise(positions, tangents)[1]
