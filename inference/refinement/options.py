"""Options of a refinement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from inference.settings import ReconstructOptions
from physconvex import InputError
from physconvex.identify import Nuisance
from physconvex.io import CommandLine, Options

_UNKNOWN, _MODEL, _RESULT = (CommandLine(panel=name) for name in ("Unknowns", "Models", "Results"))
_SEEN = CommandLine(panel="What was observed")
_NEED_VALUE = ("log10_youngs_modulus", "poisson_ratio")  # no capture states them


def _number(text: str, value: str, form: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"got {text!r}; expected {form} with numbers") from None


def _value(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    return name, _number(text, value, "NAME=VALUE")


def _held(text: str) -> tuple[str, float | None]:
    return _value(text) if "=" in text else (text, None)


def _prior(text: str) -> tuple[str, tuple[float, float]]:
    name, _, values = text.partition("=")
    parts: Sequence[str] = values.split(",")
    if len(parts) != 2:
        raise InputError(f"prior: got {text!r}; expected NAME=MEAN,SIGMA")
    return name, (_number(text, parts[0], "NAME=MEAN,SIGMA"), _number(text, parts[1], "NAME=MEAN,SIGMA"))


class RefineOptions(Options):
    """Settings of `refine`."""

    observations: Annotated[Literal["auto", "tracks", "video", "both"], _SEEN] = "auto"
    """Data to fit; auto takes marker tracks if the capture has them, else videos."""
    cameras: Annotated[tuple[str, ...] | None, CommandLine("--camera", panel=_SEEN.panel)] = None
    """Use only this camera; repeatable. Default: all."""
    points: Annotated[bool, _SEEN] = True
    """Follow points in the videos; without them outlines are needed."""
    outlines: Annotated[bool, _SEEN] = True
    """Fit the outlines of the masks as well."""
    colours: Annotated[bool, _SEEN] = True
    """Compare colours of pixels in the convex twin's fit, and in the last one instead of followed points."""
    exposure: Annotated[bool, _SEEN] = True
    """Fit gain and offset of the colours of each frame."""
    body: Annotated[Path | None, _SEEN] = None
    """Mesh of the closed surface at t = 0 [m], in place of the capture's. Default: that of the capture, else
    reconstructed from the first frames of its cameras."""
    nuisance: Nuisance = Field(default_factory=Nuisance)
    """Priors of camera pose and time offset; none is free unless given."""

    free: Annotated[tuple[str, ...], _UNKNOWN] = ()
    """Fit this parameter too, such as friction, air_drag or initial_velocity_z; repeatable."""
    fixed: Annotated[Mapping[str, float | None], CommandLine("--fix", panel=_UNKNOWN.panel, parse=_held)] = Field(
        default_factory=dict
    )
    """Hold a parameter: NAME (at the value of the capture) or NAME=VALUE, such as damping_time=0; repeatable."""
    priors: Annotated[Mapping[str, tuple[float, float]], CommandLine("--prior", panel=_UNKNOWN.panel, parse=_prior)] = (
        Field(default_factory=dict)
    )
    """Gaussian prior NAME=MEAN,SIGMA, such as poisson_ratio=0.49,0.005; repeatable."""
    initial: Annotated[Mapping[str, float], CommandLine(panel=_UNKNOWN.panel, parse=_value)] = Field(
        default_factory=dict
    )
    """Start at NAME=VALUE, such as log10_youngs_modulus=5.2, without a scan; repeatable."""
    start: Annotated[Literal["auto", "predict", "scan"], _UNKNOWN] = "auto"
    """Range of the scan: predict (around the prediction of the network), scan (everywhere), auto (finely around the
    prediction, coarsely elsewhere)."""
    checkpoint: Annotated[str, _UNKNOWN] = "default"
    """Name or folder of the checkpoint of the network."""

    weights: Annotated[int, Field(ge=1), _MODEL] = 20
    """Number of skinning weights of the reduced model."""
    basis: Annotated[Literal["elastic", "eigenmodes", "neural", "predicted"], _MODEL] = "elastic"
    """Skinning weights of the convex twin: elastic (vibrations, responses to contacts, and a motion of the full model),
    eigenmodes, neural (trained on the body alone), or predicted by the network."""
    fit_weights: Annotated[int, Field(ge=0), _MODEL] = 0
    """How often the network of the weights (basis neural) is fitted to the finest images, E and ν after it; held near
    the energy that it was trained with."""
    pixels: Annotated[tuple[int, ...], _MODEL] = (24,)
    """Compared pixels across the object in the convex twin's fit; repeatable, coarse to fine."""
    convex: Annotated[bool | None, _MODEL] = None
    """Fit the convex twin to all pixels of the videos; its values are a start of the correction. Default: if the body
    is reconstructed from pictures."""
    stop_after: Annotated[Literal["convex"] | None, _MODEL] = None
    """Stop after this stage: convex gives the quick answer of the convex twin, without the full-order model."""
    max_nodes: Annotated[int, Field(ge=30), _MODEL] = 500
    """Most nodes of the quadratic mesh of both models."""
    fine_nodes: Annotated[int | None, Field(ge=0), _MODEL] = None
    """Most nodes of the mesh of the last fits. Applies to a body that hits an obstacle and whose mesh is made from its
    surface. A value up to max_nodes keeps the first mesh. Default: 2400; 1400 for a soft body."""
    steps_per_frame: Annotated[int | None, Field(ge=1), _MODEL] = None
    """Time steps per frame. Default: 384 per second; from the wave speed for a body that hits an obstacle."""
    fill: Annotated[bool, _MODEL] = True
    """Integrate mass and energy over the inside of the surface, not over the mesh that is made from it."""
    correction: Annotated[bool, _MODEL] = True
    """Correct the error of the reduced model with the full-order model."""
    full_runs: Annotated[int, Field(ge=1), _MODEL] = 8
    """Most linearisations of the full-order model in the correction."""
    jacobian: Annotated[Literal["full", "reduced"], _MODEL] = "full"
    """Model that gives the derivatives of the correction."""
    model_error: Annotated[bool, _MODEL] = True
    """Fit a finer model too; its difference corrects the estimates and widens the intervals."""
    drift: Annotated[bool, _MODEL] = True
    """Allow a rigid drift between model and recording after a contact, if the data favour it."""

    field: Annotated[bool, _RESULT] = True
    """Fit a convex field to the first images and bind it to the body."""
    field_file: Annotated[str | None, _RESULT] = None
    """Use this convex field (PLY) of the body at rest instead of fitting one."""
    field_budget: Annotated[int | None, Field(ge=50), _RESULT] = None
    """Most convexes of the convex field. Default: 16000 if the body is reconstructed, else 6000."""
    field_steps: Annotated[int | None, Field(ge=1), _RESULT] = None
    """Steps of the fit of the convex field. Default: 200 if the body is reconstructed, else 150."""
    field_points: Annotated[int, Field(ge=3, le=9), _RESULT] = 6
    """Points per convex of the convex field."""
    device: Annotated[str, _RESULT] = "cpu"
    """Torch device of the network and of the convex field, such as cpu or cuda. The rest runs on the CPU."""
    processes: Annotated[int, Field(ge=1), CommandLine(hidden=True)] = 1
    """Number of simulations at once; it changes results by rounding only. With more than one, a script that calls
    `refine` needs `if __name__ == "__main__"`, as for all worker processes in Python."""

    @model_validator(mode="after")
    def _fitted_weights(self) -> Self:
        if self.fit_weights and not self.colours:
            raise InputError(f"fit_weights: got {self.fit_weights} without colours, to which weights are fitted")
        if self.fit_weights and self.basis != "neural":
            raise InputError(
                f"fit_weights: got {self.fit_weights} with basis {self.basis!r}; expected basis 'neural', that of a "
                "network, or 0"
            )
        return self

    @field_validator("pixels")
    @classmethod
    def _coarse_to_fine(cls, pixels: tuple[int, ...]) -> tuple[int, ...]:
        if not pixels or pixels[0] < 8 or any(b <= a for a, b in pairwise(pixels)):
            raise InputError(f"pixels: got {pixels}; expected one or more ascending numbers, from 8 on")
        return pixels

    @field_validator("fixed")
    @classmethod
    def _stated(cls, fixed: Mapping[str, float | None]) -> Mapping[str, float | None]:
        for name in _NEED_VALUE:
            if name in fixed and fixed[name] is None:
                raise InputError(f"fixed: {name} needs a value, since no capture states it; give {name}=VALUE")
        ratio = fixed.get("poisson_ratio")
        if ratio is not None and not -1 < ratio < 0.5:
            raise InputError(f"fixed (--fix): poisson_ratio is {ratio:g}; expected more than -1 and less than 0.5")
        return fixed

    @property
    def reconstruction(self) -> ReconstructOptions:
        """Settings of the reconstruction of the body, where the capture does not state it."""
        points = (f"points_per_convex={self.field_points}",)
        return ReconstructOptions(budget=self.field_budget, steps=self.field_steps, settings=points, device=self.device)

    @property
    def own_derivatives(self) -> bool:
        """Whether the full model is fitted with its own derivatives."""
        return self.correction and self.jacobian == "full"

    def states(self, name: str) -> bool:
        """Whether a parameter is free or held by the user's wish."""
        return name in self.free or name in self.fixed

    @property
    def held(self) -> dict[str, float]:
        """The parameters that are held at a value of the user's."""
        return {name: value for name, value in self.fixed.items() if value is not None}
