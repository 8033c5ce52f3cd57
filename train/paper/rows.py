"""Stored results of each object, `OUT/objects/NAME.json`: one part per method of fitting."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict, cast

from pydantic import JsonValue

from physconvex.io import write_json

_OWN = ("object", "truth", "truth_itself")


class PictureScores(TypedDict, total=False):
    """Means over the frames of a part of the motion, of the front view or of the others.

    PSNR [dB] and SSIM are of whole images, `psnr_object` of the pixels that are not white in either image; `fovvdp` is
    the quality in JOD (Mantiuk et al. 2021) of the front view, where `pyfvvdp` is installed.
    """

    psnr: float
    ssim: float
    psnr_object: float
    fovvdp: float | None


class Change(TypedDict):
    """Rms distance from the truth under a change, and the distance that the change moves the truth [m]."""

    rms_m: float
    change_rms_m: float


class PaperPart(TypedDict, total=False):
    """Results of one method of fitting for an object, or its error; each method has some of these.

    Views are "front" and "others", stretches of the motion "observed" and "future".
    """

    failure: str
    process_seconds: float
    seconds: float
    # of the fit: log10 E and ν, and fit minus truth
    values: list[float]
    errors: list[float]
    intervals_90: list[list[float] | None]
    covered: list[bool | None]
    losses: list[float]
    steps: int
    in_words: list[str]
    reduced_model_rms_m: list[float]
    # of the motion
    rms_m: list[float]
    pictures: dict[str, dict[str, PictureScores]]
    changes: dict[str, Change]
    drift: dict[str, JsonValue] | None
    # of a reconstruction: primitives, quality of the first images, volume less that of the true surface, as a share
    convexes: int
    first_images: PictureScores
    volume_error: float
    # of the truth itself, compared with half its nodes and half its steps
    nodes: int
    overlap: float
    rms_to_half_steps_m: list[float]
    rms_to_half_nodes_m: list[float]


@dataclass
class ObjectRow:
    """One object.

    Attributes:
        object: its name.
        truth: log10 E and ν.
        truth_itself: the truth's own errors.
        parts: by name, as they are finished.
    """

    object: str
    truth: dict[str, float] = field(default_factory=dict)
    truth_itself: PaperPart = field(default_factory=PaperPart)
    parts: dict[str, PaperPart] = field(default_factory=dict)

    @classmethod
    def of_json(cls, content: Mapping[str, JsonValue]) -> ObjectRow:
        """From what is stored."""
        own: dict[str, Any] = {name: content[name] for name in _OWN if name in content}
        parts = {name: part for name, part in content.items() if name not in _OWN}
        return cls(**own, parts=cast("dict[str, PaperPart]", parts))

    @classmethod
    def read(cls, file: Path) -> ObjectRow:
        """From its file."""
        return cls.of_json(json.loads(file.read_text(encoding="utf-8")))

    def to_json(self) -> dict[str, JsonValue]:
        """What is stored."""
        own = {name: getattr(self, name) for name in _OWN}
        return cast("dict[str, JsonValue]", own | self.parts)

    def write(self, file: Path) -> None:
        """To its file, whole or not at all."""
        write_json(file, self.to_json(), allow_nan=True)  # PSNR of equal pictures is infinite

    def with_part(self, name: str, key: str) -> PaperPart | None:
        """A part with that entry; None if it is missing or failed."""
        part = self.parts.get(name)
        return part if part is not None and key in part else None
