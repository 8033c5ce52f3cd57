"""The array files of a capture folder: marker tracks, tetrahedra, boundary conditions."""

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from physconvex.errors import InputError


@dataclass(frozen=True)
class Tracks:
    """Points of the body that were followed through time, world frame."""

    rest: Float64[np.ndarray, "P 3"]  # [m], at rest
    positions: Float64[np.ndarray, "T P 3"]  # [m]; NaN = not seen
    sigma: Float64[np.ndarray, "T P"]  # [m], standard deviation of each coordinate

    def __post_init__(self) -> None:
        points, shape = len(self.rest), self.positions.shape
        if self.rest.shape != (points, 3) or not np.isfinite(self.rest).all():
            raise InputError(f"tracks: rest: got shape {self.rest.shape}, expected finite [P, 3] in metres")
        if shape != (shape[0], points, 3) or np.isinf(self.positions).any():
            raise InputError(f"tracks: positions: got shape {shape}, expected [T, {points}, 3] (NaN = not seen)")
        if self.sigma.shape != shape[:2] or not (self.sigma > 0).all():
            raise InputError(f"tracks: sigma: got shape {self.sigma.shape}, expected positive [T, P] or one number [m]")


@dataclass(frozen=True)
class Boundary:
    """The held part: vertices of the tetrahedra (else of the mesh), or all in a box; and their motion."""

    clamped_vertices: Int64[np.ndarray, " C"] | None = None
    clamped_box: Float64[np.ndarray, "2 3"] | None = None  # [m], lowest and highest corner, rest frame
    motion: Float64[np.ndarray, "T C 3"] | None = None  # [m], positions in each frame; None = at rest

    def __post_init__(self) -> None:
        vertices, box, motion = self.clamped_vertices, self.clamped_box, self.motion
        if (vertices is None) == (box is None):
            raise InputError("boundary: expected either clamped_vertices or clamped_box, one of them")
        if vertices is not None and (vertices.ndim != 1 or len(vertices) == 0 or vertices.min() < 0):
            raise InputError(f"boundary: clamped_vertices: got {vertices.shape}, expected indices [C]")
        if box is not None and (box.shape != (2, 3) or not (box[0] <= box[1]).all()):
            raise InputError(f"boundary: clamped_box: got {box.tolist()}, expected [[lowest], [highest]] corner")
        if motion is not None:
            fits = motion.ndim == 3 and motion.shape[2] == 3 and (vertices is None or motion.shape[1] == len(vertices))
            if not (fits and np.isfinite(motion).all()):
                raise InputError(f"boundary: motion: got shape {motion.shape}, expected finite [T, C, 3]")


def read_tracks(path: Path) -> Tracks:
    """Read `tracks.npz`."""
    arrays = read_arrays(path, needed=("rest", "positions", "sigma"))
    positions = _floats(path, "positions", arrays["positions"])
    sigma = _floats(path, "sigma", arrays["sigma"])
    if sigma.ndim == 0 and positions.ndim == 3:
        sigma = np.full(positions.shape[:2], float(sigma))
    return Tracks(rest=_floats(path, "rest", arrays["rest"]), positions=positions, sigma=sigma)


def read_boundary(path: Path) -> Boundary:
    """Read `boundary.npz`."""
    arrays = read_arrays(path, needed=())
    vertices = arrays.get("clamped_vertices")
    if vertices is not None and not np.issubdtype(vertices.dtype, np.integer):
        raise InputError(f"{path}: clamped_vertices: got {vertices.dtype}, expected integer indices")
    box, motion = arrays.get("clamped_box"), arrays.get("motion")
    return Boundary(
        clamped_vertices=None if vertices is None else vertices.astype(np.int64),
        clamped_box=None if box is None else _floats(path, "clamped_box", box),
        motion=None if motion is None else _floats(path, "motion", motion),
    )


def read_arrays(path: Path, *, needed: Sequence[str]) -> dict[str, np.ndarray]:
    """All arrays of an npz file.

    Raises:
        InputError: unreadable, not an npz file of plain arrays, or an array of `needed` is missing.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile, AttributeError, TypeError) as error:
        raise InputError(f"{path}: not a readable npz file of plain arrays ({error})") from None
    missing = [name for name in needed if name not in arrays]
    if missing:
        raise InputError(f"{path}: holds {sorted(arrays)}, expected also {missing}")
    return arrays


def _floats(path: Path, name: str, array: np.ndarray) -> Float64[np.ndarray, "..."]:
    if not (np.issubdtype(array.dtype, np.floating) or np.issubdtype(array.dtype, np.integer)):
        raise InputError(f"{path}: {name}: got {array.dtype}, expected numbers")
    return np.asarray(array, dtype=np.float64)
