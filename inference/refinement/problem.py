"""The problem of a refinement: the twin with the fixed values, the unknowns, the observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from inference.refinement.observations import Observed
from physconvex.fem import SurfacePoints
from physconvex.identify import (
    Fit,
    FullModel,
    MarginalObservations,
    Nuisance,
    Observations,
    Parameter,
    ReducedModel,
    RigidDriftObservations,
    RollOuts,
    Twin,
    WeightedObservations,
    frame_errors,
)
from physconvex.mesh import TetMesh
from physconvex.reduced import parameter_values

_LEFT = 0.5  # of the difference between few and more nodes: remaining error of more nodes
HELD = 1e-3  # standard deviation of the prior of a value that is held, in typical steps


@dataclass(frozen=True, eq=False)
class Problem:
    """The problem of a fit.

    Attributes:
        twin: body and world, with the fixed values.
        parameters: the unknowns.
        observed: the observations.
        nuisance: priors of camera and clock.
        surface: points at which obstacles act, instead of the mesh's nodes.
        mesh: mesh of the full model; None: the twin's.
        astray: rms distance of the body from its position on that mesh, at most [m].
        errors: of the model by frame, in standard deviations of the noise, shape [T].
        drift: standard deviation of the rigid drift after a contact [m/s].
        drift_limit: first frame with drift, and the largest deviation considered [m/s]; None if there is no contact.
    """

    twin: Twin
    parameters: tuple[Parameter, ...]
    observed: Observed
    nuisance: Nuisance = field(default_factory=Nuisance)
    surface: SurfacePoints | None = None
    mesh: TetMesh | None = None
    astray: float = 0.0
    errors: np.ndarray | None = None
    drift: float = 0.0
    drift_limit: tuple[int, float] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(p.name for p in self.parameters)

    @property
    def undrifted(self) -> Observations:
        """The observations, nuisances of camera and clock eliminated."""
        seen = self.observed.observations
        return MarginalObservations(seen, self.nuisance, 1 / self.twin.fps) if self.nuisance.any else seen

    @cached_property
    def seen(self) -> Observations:
        """The observations, all nuisances eliminated."""
        if not self.drift:
            return self.undrifted
        assert self.drift_limit is not None
        return RigidDriftObservations(self.undrifted, self.drift_limit[0], 1 / self.twin.fps, self.drift)

    @property
    def weighted(self) -> Observations:
        """The observations, frames weighted by the model's error."""
        return self.seen if self.errors is None else WeightedObservations.by_errors(self.seen, self.errors)

    def errors_between(
        self, here: Float[np.ndarray, "T P 3"], there: Float[np.ndarray, "T P 3"]
    ) -> Float[np.ndarray, " T"]:
        """The model's error by frame, from its positions on two meshes [m]; in standard deviations of the noise."""
        return _LEFT * frame_errors(self.seen, here, there)

    @cached_property
    def reduced(self) -> ReducedModel:
        """The reduced model of the observed points."""
        return ReducedModel(self.twin, self.names, self.seen.points, self.frames)

    def full(self, memory: RollOuts) -> FullModel:
        """The full model of the observed points."""
        held = tuple(p.name for p in self.parameters if is_held(p))
        return FullModel(
            self.twin, self.names, self.seen.points, self.frames,
            mesh=self.mesh, surface=self.surface, memory=memory, held=held,
        )  # fmt: skip

    @property
    def frames(self) -> int:
        """Number of frames that are fitted."""
        return int(self.seen.frames.max()) + 1

    @property
    def windows(self) -> tuple[int, ...]:
        """Increasing numbers of frames, to be fitted one after the other.

        A held body swings: over many periods the misfit has one minimum per period, over one period a single one.
        """
        count = self.frames
        if self.twin.clamp is None:
            return (count,)
        return tuple(dict.fromkeys(max(2, round(count * share)) for share in (0.25, 0.5, 1.0)))

    def first(self, frames: int) -> Problem:
        """The first frames alone."""
        part = replace(self.observed, observations=self.observed.observations.in_frames(frames))
        return replace(self, observed=part)


def started_from(parameters: tuple[Parameter, ...], found: Fit) -> tuple[Parameter, ...]:
    """The parameters, starting where a fit has ended."""
    return tuple(p.at(float(v)) for p, v in zip(parameters, found.values, strict=True))


def is_held(parameter: Parameter) -> bool:
    """Whether a parameter keeps its value in all fits."""
    return parameter.prior_sigma <= HELD * parameter.step


def tried(parameter: Parameter, values: Sequence[float]) -> list[float]:
    """Values of a parameter to be tried, moved inside its bounds; its start alone if it is held."""
    return [parameter.start] if is_held(parameter) else [parameter.at(float(value)).start for value in values]


def moved_inside(
    parameters: tuple[Parameter, ...], found: Fit, candidates: Sequence[np.ndarray]
) -> tuple[Fit, tuple[np.ndarray, ...]]:
    """A fit and other values of its parameters, moved inside the bounds of others; new ones are at their start."""

    def placed(row: np.ndarray) -> np.ndarray:
        return np.array([p.at(v).start for p, v in zip(parameters, values_of(parameters, found, row), strict=True)])

    columns = {name: found.jacobian[:, k] for k, name in enumerate(found.names)} if found.jacobian.size else {}
    none = np.zeros(len(found.residuals))
    jacobian = np.array([columns.get(p.name, none) for p in parameters]).T
    moved = replace(found, parameters=parameters, values=placed(found.values), jacobian=jacobian)
    return moved, tuple(map(placed, candidates))


def values_of(parameters: Sequence[Parameter], found: Fit, values: np.ndarray) -> np.ndarray:
    """Values of a fit's parameters in the order of others, of which new ones are at their start."""
    known = dict(zip(found.names, values.tolist(), strict=True))
    return np.array([known.get(p.name, p.start) for p in parameters])


def material_of(twin: Twin, found: Fit) -> tuple[float, float]:
    """Log10 of E [Pa] and the density [kg/m³] at a fit, whether they are free or not."""
    scene = twin.with_values(found.names, found.values).scene
    modulus, density = parameter_values(scene, ["log10_youngs_modulus", "density"])
    return float(modulus), float(density)


def in_pixels(problem: Problem, length: float) -> float:
    """A length [m] at the body's initial position, in the images of the nearest camera."""
    centre = problem.twin.mesh.vertices.mean(axis=0)
    return length * float(max(camera.fl_x / camera.project(centre)[1] for camera in problem.observed.cameras))
