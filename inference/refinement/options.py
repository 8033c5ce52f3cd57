"""What the user decides about a refinement."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from physconvex import InputError
from physconvex.identify import Nuisance

__all__ = ["RefineOptions"]


@dataclass(frozen=True)
class RefineOptions:
    """Settings of `refine`.

    Attributes:
        observations: "auto" takes marker tracks where there are some, else videos; "tracks", "video" or "both".
        cameras: names of the cameras that are used; None: all.
        weights: number of skinning weights M of the reduced model.
        max_nodes: most nodes of the quadratic mesh of both models.
        fine_nodes: most nodes of that of the last searches, where the body strikes something and its mesh is made of
            the surface; none is made with `max_nodes` or fewer. None: as many as its stiffness allows, see
            `inference.refinement.meshes.fine_mesh`.
        steps_per_frame: time steps per frame; None: at least 384 per second.
        fill: whether mass and energy of a mesh that is made of the surface are those of the surface's inside, see
            `physconvex.fem.filled`.
        free: parameters beyond E, ν, the damping time and what the capture does not state of the initial motion.
        fixed: parameters that stay, with their values; None: as the capture has it (E and ν need a value).
        priors: mean and standard deviation by parameter.
        initial: values to start at, by name, such as log10_youngs_modulus; with E among them nothing is scanned.
        start: where the scan looks: "predict" around the network's prediction (videos), "scan" everywhere, "auto"
            closely around the prediction and coarsely everywhere else.
        correction: remove the reduced model's error with runs of the full one.
        full_runs: most states (with `jacobian` "reduced": most runs) of the full model that the correction tries.
        jacobian: of the correction: "full", the full model's own derivatives, or "reduced", the reduced model's.
        model_error: runs with a finer mesh and a shorter step, whose difference is added, and the error left stated.
        drift: from the first contact on, let the recording drift from the model by a rigid motion, where that is
            likelier (with the full model's derivatives).
        outlines: use the masks of videos.
        colours: last, compare colours instead of points followed in videos.
        exposure: gain and offset of each frame's colours are free.
        nuisance: priors of camera pose and time offset; none is free unless given.
        field: fit a convex field to the first images, and bind it to the body.
        field_file: a field (PLY) of the body at rest, in the place of that.
        field_budget, field_steps: most convexes, and steps of their fit.
        checkpoint: of the network.
        device: torch device of the network and of the field's fit, such as "cpu" or "cuda". Everything else is the
            processor's.
        processes: in which what is wanted together is made. Results depend on it by rounding alone. With more than one,
            a script that calls `refine` needs `if __name__ == "__main__"`, as for all of Python's worker processes.
    """

    observations: Literal["auto", "tracks", "video", "both"] = "auto"
    cameras: tuple[str, ...] | None = None
    weights: int = 20
    max_nodes: int = 500
    fine_nodes: int | None = None
    steps_per_frame: int | None = None
    fill: bool = True
    free: tuple[str, ...] = ()
    fixed: Mapping[str, float | None] = dataclasses.field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    initial: Mapping[str, float] = dataclasses.field(default_factory=dict)
    start: Literal["auto", "predict", "scan"] = "auto"
    correction: bool = True
    full_runs: int = 8
    jacobian: Literal["full", "reduced"] = "full"
    model_error: bool = True
    drift: bool = True
    outlines: bool = True
    colours: bool = True
    exposure: bool = True
    nuisance: Nuisance = dataclasses.field(default_factory=Nuisance)
    field: bool = True
    field_file: str | None = None
    field_budget: int = 6000
    field_steps: int = 150
    checkpoint: str = "default"
    device: str = "cpu"
    processes: int = 1

    def __post_init__(self) -> None:
        choices = {
            "observations": ("auto", "tracks", "video", "both"),
            "start": ("auto", "predict", "scan"),
            "jacobian": ("full", "reduced"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise InputError(f"{name}: got {getattr(self, name)!r}; expected one of {', '.join(allowed)}")
        for name, least in {
            "weights": 1,
            "max_nodes": 30,
            "fine_nodes": 0,
            "full_runs": 1,
            "field_budget": 50,
            "field_steps": 1,
        }.items():
            if getattr(self, name) is not None and getattr(self, name) < least:
                raise InputError(f"{name}: got {getattr(self, name)}; expected at least {least}")
        for name in ("log10_youngs_modulus", "poisson_ratio"):
            if name in self.fixed and self.fixed[name] is None:
                raise InputError(f"fixed: {name} needs a value, since no capture states it; give {name}=VALUE")
        if self.processes < 1:
            raise InputError(f"processes: got {self.processes}; expected at least 1")
        if self.steps_per_frame is not None and self.steps_per_frame < 1:
            raise InputError(f"steps_per_frame: got {self.steps_per_frame}; expected at least 1")

    @property
    def own_derivatives(self) -> bool:
        """Whether the full model is fitted with its own derivatives."""
        return self.correction and self.jacobian == "full"

    def as_json(self) -> dict[str, Any]:
        """All settings, for the result's file."""
        priors = {name: list(pair) for name, pair in self.priors.items()}
        return asdict(self) | {"fixed": dict(self.fixed), "initial": dict(self.initial), "priors": priors}
