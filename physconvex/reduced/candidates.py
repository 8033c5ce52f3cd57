"""Many parameter sets of one body rolled out at once, on the CPU or on a GPU, by the same torch code in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from physconvex.contact import Plane
from physconvex.errors import InputError
from physconvex.fem.scene import CONTACT_STIFFNESS_RATIO
from physconvex.integrators import check_stepping
from physconvex.reduced.candidate_equations import CandidateEquations, CandidateValues, Step
from physconvex.reduced.candidate_newton import CandidateNewton
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.space import ReducedSpace

__all__ = ["CandidateTrajectories", "Candidates", "simulate_candidates"]

Column = float | Float[np.ndarray, " B"]


@dataclass(frozen=True)
class Candidates:
    """Parameter sets, arrays of one length B or numbers that all of them share; what is None is the scene's.

    Attributes:
        youngs_modulus: E [Pa], of the whole body.
        poisson_ratio: ν [-].
        damping_time: Kelvin–Voigt time [s].
        friction: Coulomb coefficient of every obstacle [-].
        initial_velocity: of the centre of mass [m/s], shape [B, 3] or [3].

    Raises:
        InputError: lengths that differ, or a value out of range.
    """

    youngs_modulus: Column
    poisson_ratio: Column
    damping_time: Column | None = None
    friction: Column | None = None
    initial_velocity: Float[np.ndarray, "... 3"] | None = None

    def __post_init__(self) -> None:
        ranges = {"youngs_modulus": (0, np.inf), "poisson_ratio": (-1, 0.5)}
        lengths = set()
        for name in ("youngs_modulus", "poisson_ratio", "damping_time", "friction"):
            if getattr(self, name) is None:
                continue
            value = np.asarray(getattr(self, name), dtype=np.float64)
            low, high = ranges.get(name, (-np.finfo(float).tiny, np.inf))
            if value.ndim > 1 or not ((value > low) & (value < high)).all():
                raise InputError(f"{name}: got {value!r}; expected a number or [B], inside ({low}, {high})")
            lengths |= set(value.shape)
        if self.initial_velocity is not None:
            velocity = np.asarray(self.initial_velocity, dtype=np.float64)
            if velocity.ndim not in (1, 2) or velocity.shape[-1] != 3 or not np.isfinite(velocity).all():
                raise InputError(f"initial_velocity: got shape {velocity.shape}; expected finite [B, 3] or [3]")
            lengths |= set(velocity.shape[:-1])
        if len(lengths) > 1:
            raise InputError(f"candidates: got columns of the lengths {sorted(lengths)}; expected one length")
        object.__setattr__(self, "_count", lengths.pop() if lengths else 1)

    def __len__(self) -> int:
        return int(self._count)  # type: ignore[attr-defined]

    def column(self, name: str, default: float) -> Float[np.ndarray, " B"]:
        """Values of all candidates."""
        value = getattr(self, name)
        return np.broadcast_to(np.asarray(default if value is None else value, dtype=np.float64), len(self)).copy()


@dataclass(frozen=True)
class CandidateTrajectories:
    """States of all candidates at the frames, on the device they were computed on.

    Attributes:
        space: the reduced space.
        times: [s], shape [T].
        coordinates: y [m], shape [B, T, R, 3]; NaN from the first frame that a candidate did not reach.
        velocities: ẏ [m/s], the same shape.
        failed: candidates of which a step did not converge, shape [B].
        iterations: Newton steps of each candidate, shape [B].
        factorisations: of each candidate, shape [B].
    """

    space: ReducedSpace
    times: Float[np.ndarray, " T"]
    coordinates: Float[Tensor, "B T R 3"]
    velocities: Float[Tensor, "B T R 3"]
    failed: Bool[np.ndarray, " B"]
    iterations: np.ndarray
    factorisations: np.ndarray

    def positions(self, points: Float[np.ndarray, "P 3"]) -> Float[Tensor, "B T P 3"]:
        """Where material points, given by their rest positions [m], are at the frames [m]."""
        return torch.as_tensor(self.space.shape_values(points)).to(self.coordinates) @ self.coordinates


def simulate_candidates(
    scene: ReducedScene,
    candidates: Candidates,
    *,
    frames: int = 24,
    fps: float = 24.0,
    steps_per_frame: int = 16,
    tolerance: float = 3e-8,
    friction_passes: int = 12,
    device: str | torch.device = "cpu",
) -> CandidateTrajectories:
    """Roll all candidates out together: BDF2, Newton with line search, friction in passes, as `simulate` does for one.

    Each candidate keeps its own factor, line search and number of passes; one that has converged waits. A step that
    does not converge is not halved: the candidate is marked `failed` and its later frames are NaN.

    Args:
        scene: an elastic body, planes, gravity, push, air drag, any initial state; kc follows each candidate's E
            unless the scene gives it.
        candidates: what differs.
        frames, fps, steps_per_frame, tolerance, friction_passes: as in `simulate`.
        device: of the arithmetic, for example "cuda".

    Raises:
        InputError: an argument out of range, or a scene with flow, wind, pins, loads, contact damping or spheres.
    """
    check_stepping(frames, fps, steps_per_frame, "bdf2", friction_passes)
    _check(scene)
    place = torch.device(device)
    equations = _equations(scene, candidates, place)
    newton = CandidateNewton(equations, len(candidates), tolerance * scene.body.space.samples.size, friction_passes)
    y = equations.tensor(scene.start).expand(len(candidates), -1, -1).clone()
    v = equations.tensor(_velocities(scene, candidates))
    step, time = 1.0 / (fps * steps_per_frame), 0.0
    past: tuple[Tensor, Tensor] | None = None
    shown = [(y, v)]
    for _ in range(1, frames):
        for _ in range(steps_per_frame):
            guess = y + step * v if past is None else y + step * (1.5 * v - 0.5 * past[1])
            now = _coefficients(y, v, past, step, time + step)
            equations.set_step(now, guess, y, time)
            new = newton.advance(guess)
            past, y, v, time = (y, v), new, now.velocity(new, newton.everyone), time + step
        lost = newton.failed[:, None, None]
        shown.append((torch.where(lost, torch.nan, y), torch.where(lost, torch.nan, v)))
    return CandidateTrajectories(
        scene.body.space,
        np.arange(frames) / fps,
        torch.stack([s[0] for s in shown], dim=1),
        torch.stack([s[1] for s in shown], dim=1),
        newton.failed.cpu().numpy(),
        newton.iterations.cpu().numpy(),
        newton.factorisations.cpu().numpy(),
    )


def _check(scene: ReducedScene) -> None:
    """Refuse what the batch has no arithmetic for."""
    there = {
        "flow": scene.body.flow is not None,
        "wind": scene.wind is not None,
        "pins": scene.pins is not None,
        "loads": scene.loads is not None,
        "contact_damping": scene.contact_damping > 0,
        "spheres": not all(isinstance(obstacle, Plane) for obstacle in scene.obstacles),
    }
    if any(there.values()):
        names = ", ".join(name for name, found in there.items() if found)
        raise InputError(f"scene: it has {names}, which candidates cannot have; use `simulate` for each of them")


def _equations(scene: ReducedScene, candidates: Candidates, place: torch.device) -> CandidateEquations:
    modulus = candidates.column("youngs_modulus", 0.0)
    stiffness = CONTACT_STIFFNESS_RATIO * modulus / scene.body.space.samples.size
    if scene.contact_stiffness is not None:
        stiffness = np.full(len(candidates), scene.contact_stiffness)
    rough = [obstacle.friction for obstacle in scene.obstacles]
    if candidates.friction is None and len(set(rough)) > 1:
        raise InputError(f"candidates.friction: got None, and the obstacles have {rough}; expected one for all of them")
    values = CandidateValues(
        modulus,
        candidates.column("poisson_ratio", 0.0),
        candidates.column("damping_time", scene.damping_time),
        candidates.column("friction", rough[0] if rough else 0.0),
        stiffness,
    )
    return CandidateEquations(scene, values, place)


def _velocities(scene: ReducedScene, candidates: Candidates) -> Float[np.ndarray, "B R 3"]:
    """Initial velocities of the coordinates: the scene's, with other velocities of the centre of mass."""
    usual = np.broadcast_to(scene.start_velocities(), (len(candidates), *scene.start.shape))
    if candidates.initial_velocity is None:
        return usual
    change = np.broadcast_to(candidates.initial_velocity, (len(candidates), 3)) - np.asarray(scene.initial_velocity)
    one = scene.body.space.affine(np.zeros((3, 3)), np.array([1.0, 0.0, 0.0]))[:, 0]
    return usual + one[:, None] * change[:, None]


def _coefficients(y: Tensor, v: Tensor, past: tuple[Tensor, Tensor] | None, step: float, time: float) -> Step:
    """BDF2, or implicit Euler in the first step; see `physconvex.integrators`."""
    if past is None:
        return Step(step, y + step * v, y, time, step)
    base, drift = (4 * y - past[0]) / 3, (4 * v - past[1]) / 3
    return Step(2 / 3 * step, base + 2 / 3 * step * drift, base, time, step)
