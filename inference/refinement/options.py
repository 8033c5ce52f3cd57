"""Options of a refinement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from pydantic import Field, field_validator

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
    """What is fitted; auto takes marker tracks where there are some, else videos."""
    cameras: Annotated[tuple[str, ...] | None, CommandLine("--camera", panel=_SEEN.panel)] = None
    """Use this camera alone; repeatable. Default: all."""
    outlines: Annotated[bool, _SEEN] = True
    """Use the masks of videos."""
    colours: Annotated[bool, _SEEN] = True
    """Last, compare colours instead of points followed in videos."""
    exposure: Annotated[bool, _SEEN] = True
    """Gain and offset of each frame's colours are free."""
    nuisance: Nuisance = Field(default_factory=Nuisance)
    """Priors of camera pose and time offset; none is free unless given."""

    free: Annotated[tuple[str, ...], _UNKNOWN] = ()
    """Free a parameter, as friction, air_drag, initial_velocity_z; repeatable."""
    fixed: Annotated[Mapping[str, float | None], CommandLine("--fix", panel=_UNKNOWN.panel, parse=_held)] = Field(
        default_factory=dict
    )
    """Hold a parameter: NAME (as the capture has it), or NAME=VALUE, as damping_time=0; repeatable."""
    priors: Annotated[Mapping[str, tuple[float, float]], CommandLine("--prior", panel=_UNKNOWN.panel, parse=_prior)] = (
        Field(default_factory=dict)
    )
    """Gaussian prior NAME=MEAN,SIGMA, as poisson_ratio=0.49,0.005; repeatable."""
    initial: Annotated[Mapping[str, float], CommandLine(panel=_UNKNOWN.panel, parse=_value)] = Field(
        default_factory=dict
    )
    """Start at NAME=VALUE, as log10_youngs_modulus=5.2, and do not scan; repeatable."""
    start: Annotated[Literal["auto", "predict", "scan"], _UNKNOWN] = "auto"
    """Where the scan looks: predict (around the network's prediction), scan (everywhere), auto (closely around the
    prediction and coarsely everywhere else)."""
    checkpoint: Annotated[str, _UNKNOWN] = "default"
    """Name or folder of the network's checkpoint."""

    weights: Annotated[int, Field(ge=1), _MODEL] = 20
    """Number of skinning weights of the result."""
    max_nodes: Annotated[int, Field(ge=30), _MODEL] = 500
    """Most nodes of the quadratic mesh of both models."""
    fine_nodes: Annotated[int | None, Field(ge=0), _MODEL] = None
    """Most nodes of the mesh of the last searches, of a body that strikes something and whose mesh is made of its
    surface; max_nodes or fewer: no other mesh; default: 2400, of a soft body 1400."""
    steps_per_frame: Annotated[int | None, Field(ge=1), _MODEL] = None
    """Time steps per frame. Default: 384 per second; by the body's waves where it strikes something."""
    fill: Annotated[bool, _MODEL] = True
    """Let mass and energy of a mesh made of the surface be those of the surface's inside."""
    correction: Annotated[bool, _MODEL] = True
    """Remove the reduced model's error with the full model."""
    full_runs: Annotated[int, Field(ge=1), _MODEL] = 8
    """Most states of the full model that the correction tries."""
    jacobian: Annotated[Literal["full", "reduced"], _MODEL] = "full"
    """Derivatives of the correction: of the full or reduced model."""
    model_error: Annotated[bool, _MODEL] = True
    """Fit a finer model, and state the error that is left."""
    drift: Annotated[bool, _MODEL] = True
    """Let the recording drift from the model as a rigid body after a contact, where that is likelier."""

    field: Annotated[bool, _RESULT] = True
    """Fit a convex field to the first images and bind it to the body."""
    field_file: Annotated[str | None, _RESULT] = None
    """A field (PLY) of the body at rest, in place of that."""
    field_budget: Annotated[int, Field(ge=50), CommandLine(hidden=True)] = 6000
    """Most convexes of the field."""
    field_steps: Annotated[int, Field(ge=1), _RESULT] = 150
    """Steps of the field's fit."""
    device: Annotated[str, _RESULT] = "cpu"
    """Torch device of the network and the field's fit, such as cpu or cuda. Everything else is the processor's."""
    processes: Annotated[int, Field(ge=1), CommandLine(hidden=True)] = 1
    """Roll-outs made at once, which changes results by rounding alone. With more than one, a script that calls
    `refine` needs `if __name__ == "__main__"`, as for all of Python's worker processes."""

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
    def own_derivatives(self) -> bool:
        """Whether the full model is fitted with its own derivatives."""
        return self.correction and self.jacobian == "full"

    @property
    def held(self) -> dict[str, float]:
        """The parameters that are held at a value of the user's."""
        return {name: value for name, value in self.fixed.items() if value is not None}
