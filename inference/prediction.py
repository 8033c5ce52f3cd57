"""The result of a prediction: `Prediction`, its units and its JSON form."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from os import PathLike
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, UInt8

from inference.units import format_pascals, format_pascals_range
from physconvex.io import Picture, html_summary

PREDICTION_SCHEMA = "physconvex/prediction/1"

PREDICTION_UNITS: dict[str, str] = {
    "youngs_modulus": "Pa",
    "poisson_ratio": "1",
    "log10_youngs_modulus_std": "decades",
    "poisson_ratio_std": "1",
    "youngs_modulus_interval": "Pa",
    "poisson_ratio_interval": "1",
    "fps": "1/s",
    "density": "kg/m^3",
    "object_size": "m",
}


@runtime_checkable
class Weights(Protocol):
    """Skinning weights of one object (`physconvex.reduced.SkinningField`, which can do more)."""

    def __call__(self, points: Float[np.ndarray, "Q 3"]) -> Float32[np.ndarray, "Q M"]:
        """Return the weights of M handles at points [m] of the object frame."""
        ...

    def save(self, path: str | PathLike[str]) -> None:
        """Write one safetensors file."""
        ...


@runtime_checkable
class Estimated(Protocol):
    """The estimate of one clip (`models.ClipEstimate`)."""

    youngs_modulus: float
    poisson_ratio: float
    log10_youngs_modulus_std: float
    poisson_ratio_std: float
    youngs_modulus_interval: tuple[float, float]
    poisson_ratio_interval: tuple[float, float]
    skinning_field: Weights
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Elastic constants and skinning weights of one clip, with the data they depend on.

    Motion under gravity determines E / (ρ g L) and ν; E in pascals follows with `density`, `object_size` and `fps`.
    Those that are not given are defaults and are named in `assumed`.
    """

    path: str | None
    """The file or folder read; None for an array."""
    youngs_modulus: float
    """Young's modulus [Pa], the median of the predictive distribution."""
    poisson_ratio: float
    """Poisson's ratio [1]."""
    log10_youngs_modulus_std: float
    """Standard deviation of log10(E / Pa) [decades]."""
    poisson_ratio_std: float
    """Standard deviation of ν [1]."""
    youngs_modulus_interval: tuple[float, float]
    """Calibrated 90 % interval of E [Pa]."""
    poisson_ratio_interval: tuple[float, float]
    """Calibrated 90 % interval of ν [1]."""
    skinning_field: Weights
    """Skinning weights W(X): points → weights of the handles."""
    fps: float
    """Frames per second the motion was read with [1/s]."""
    density: float
    """Density used [kg/m³]."""
    object_size: float
    """Largest edge of the object's rest bounding box used [m]."""
    assumed: tuple[str, ...] = ()
    """Every default that was assumed, as `name=value unit`."""
    foreground: str
    """Source of the object's silhouette: `alpha`, `mask`, `background_model` or `whole_frame`."""
    foreground_confidence: float
    """How sure that is, 0 to 1."""
    frames_used: int
    """Frames of the clip that the prediction rests on."""
    warnings: tuple[str, ...] = ()
    """Reasons why the prediction may be worse than its intervals, one line each."""
    truncated: str = ""
    """One line that names a truncated file and states the decoded part (also a warning); else empty."""

    silhouette: UInt8[np.ndarray, "S S"] | None = None
    """Coverage of the object in the first frame, 0 to 255, as in the network's input."""

    def _repr_html_(self) -> str:
        """Numbers with their 90 % intervals and a section through the skinning weights, for a notebook."""
        from inference.pictures import weight_maps  # loads OpenCV

        low, high = self.poisson_ratio_interval
        rows = [
            (
                "Young's modulus (90 %)",
                f"{format_pascals(self.youngs_modulus)} ({format_pascals_range(*self.youngs_modulus_interval)})",
            ),
            ("Poisson's ratio (90 %)", f"{self.poisson_ratio:.2f} ({low:.2f}–{high:.2f})"),
            ("density, size, rate", f"{self.density:g} kg/m³, {self.object_size:g} m, {self.fps:g} frames/s"),
            ("object found by", f"{self.foreground.replace('_', ' ')} ({self.foreground_confidence:.0%} sure)"),
        ]
        seen = self.silhouette
        section = b"" if seen is None else weight_maps(self.skinning_field, seen, self.object_size)
        pictures = [Picture(section, "skinning weights, middle section")] if section else []
        notes = [*(f"assumed {value}" for value in self.assumed), *self.warnings]
        return html_summary(f"Prediction of {self.path or 'an array'}", rows, pictures=pictures, notes=notes)

    def to_record(self) -> dict[str, object]:
        """Return everything but the skinning field as JSON-ready values (for files and lines)."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("skinning_field", "silhouette")}
        lists = {name: list(value) for name, value in values.items() if isinstance(value, tuple)}
        return {"schema": PREDICTION_SCHEMA} | values | lists | {"units": PREDICTION_UNITS}

    def to_json(self, *, indent: int | None = None) -> str:
        """Return the prediction as JSON text with its units (the skinning field is saved apart)."""
        return json.dumps(self.to_record(), indent=indent, ensure_ascii=False, allow_nan=False)
