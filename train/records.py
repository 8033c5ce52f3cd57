"""Clips of one or more data sets for training: labels, and samples in the object frame of the view."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32

from data_gen import ClipRecord, Dataset
from physconvex import InputError
from train.motion_states import states_of_motion

Split = Literal["train", "validation", "test"]


@dataclass(frozen=True, eq=False)
class ClipSamples:
    """Points of one simulation in the object frame (`physconvex.reduced.SkinningField`), lengths over its size."""

    points: Float32[np.ndarray, "Q 3"]
    volume_weights: Float32[np.ndarray, " Q"]
    displacements: Float32[np.ndarray, "T Q 3"]
    height: float
    """Of the origin over the floor."""
    modes: Float32[np.ndarray, "Q K"]
    importance: Float32[np.ndarray, " K"]
    """√(λ₁/λ_k): 1 for the lowest mode."""

    def states(self) -> Float32[np.ndarray, "T S"]:
        """True states of the motion (`models.motion.STATE_NAMES`)."""
        return states_of_motion(self.points, self.displacements, self.volume_weights, height=self.height)


@dataclass(frozen=True, eq=False)
class LabelledClip:
    """One view of one simulation."""

    dataset: Path
    record: ClipRecord
    fps: float
    """[1/s]"""
    youngs_modulus: float
    """[Pa]"""
    poisson_ratio: float
    density: float
    """[kg/m³]"""
    object_size: float
    """Largest edge of the rest bounding box [m]."""

    @classmethod
    def of(cls, dataset: Path, record: ClipRecord) -> LabelledClip:
        """With the labels in its row of the index."""
        names = ("fps", "youngs_modulus", "poisson_ratio", "density", "object_size")
        return cls(dataset, record, *(float(record.row[name]) for name in names))

    @property
    def name(self) -> str:
        """Unique within its data set."""
        return self.record.clip_id

    @cached_property
    def samples(self) -> ClipSamples:
        """Rest points, volumes, motion and skinning eigenmodes in this view."""
        stored, size = self.record.samples(), self.object_size
        axes = camera_aligned_axes(self.record.camera.transform_matrix)
        points = np.asarray(stored.points, np.float64)
        centre = (points.min(axis=0) + points.max(axis=0)) / 2
        eigenvalues = np.maximum(np.asarray(stored.eigenvalues, np.float64), 1e-12)
        return ClipSamples(
            points=((points - centre) @ axes.T / size).astype(np.float32),
            volume_weights=(stored.volume_weights / stored.volume_weights.sum()).astype(np.float32),
            displacements=(np.asarray(stored.displacements, np.float64) @ axes.T / size).astype(np.float32),
            height=float(centre[2] / size),
            modes=np.asarray(stored.modes, np.float32),
            importance=np.sqrt(eigenvalues[0] / eigenvalues).astype(np.float32),
        )


def read_clips(datasets: Sequence[Path | str], split: Split | None = None) -> list[LabelledClip]:
    """The clips of the data sets, in the order of their indices.

    Raises:
        InputError: a folder is no data set, or no clip is in the split.
    """
    pairs = [(Path(folder), record) for folder in datasets for record in Dataset.open(folder, split=split).clips]
    clips = [LabelledClip.of(*pair) for pair in pairs]
    if not clips:
        raise InputError(
            f"data: {', '.join(map(str, datasets))} hold no clip of the split {split!r}; generate more objects"
        )
    return clips


def dataset_checksum(dataset: Path | str) -> str:
    """SHA-256 of the manifest, which holds that of every file."""
    return hashlib.sha256((Path(dataset) / "manifest.json").read_bytes()).hexdigest()


def data_listing(data: Sequence[Path | str]) -> str:
    """Data sets with their checksums, a line each, for model cards."""
    return "\n".join(f"- `{Path(folder).name}`, manifest SHA-256 `{dataset_checksum(folder)}`" for folder in data)


def camera_aligned_axes(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """Rows: to the right in the image, away from the camera, up; the first two horizontal."""
    up = np.array([0.0, 0.0, 1.0])
    right = transform[:3, 0] * [1, 1, 0]
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(up, right), up])
