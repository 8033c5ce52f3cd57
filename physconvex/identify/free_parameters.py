"""The free parameters and the marker tracks of a capture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from physconvex.errors import InputError
from physconvex.identify.observations import MarkerObservations
from physconvex.identify.parameters import Parameter, default_parameter
from physconvex.identify.twin import Twin
from physconvex.io import Capture
from physconvex.reduced import parameter_values

MATERIAL = ("log10_youngs_modulus", "poisson_ratio")
VELOCITY = tuple(f"initial_velocity_{axis}" for axis in "xyz")
SPIN = tuple(f"initial_angular_velocity_{axis}" for axis in "xyz")
_FRICTION_START = 0.3
_FIRST = 4  # frames that tell the initial motion


def marker_observations(capture: Capture, *, frames: int | None = None) -> MarkerObservations:
    """The marker tracks of a capture in its first `frames` frames (the observed ones unless given).

    Raises:
        InputError: there are no tracks, or no marker is visible in those frames.
    """
    tracks = capture.tracks()
    if tracks is None:
        raise InputError(f"{capture.folder}: no tracks.npz; expected marker tracks (rest, positions, sigma)")
    count = capture.observed_frames if frames is None else frames
    return MarkerObservations(tracks.rest, tracks.positions[:count], tracks.sigma[:count])


def default_parameters(
    twin: Twin,
    *,
    damping: bool = False,
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Parameter, ...]:
    """The unknowns of a capture: E, ν, and the parts of the initial motion of a free body that it does not state.

    Args:
        twin: its scene gives the start values.
        damping: also free the damping time (a capture never states it).
        free: further names.
        fixed: names that keep the twin's values.
        priors: mean and standard deviation by name.

    Raises:
        InputError: an unknown name, or one that is both free and fixed.
    """
    both = sorted(set(free) & set(fixed))
    if both:
        raise InputError(f"parameters: {both} are both free and fixed; name each once")
    names = [*MATERIAL, *(("damping_time",) if damping else ())]
    if twin.clamp is None:
        names += VELOCITY if twin.capture.initial_velocity is None else ()
        names += SPIN if twin.capture.initial_angular_velocity is None else ()
    names = [name for name in dict.fromkeys([*names, *free]) if name not in fixed]
    if not names:
        raise InputError("parameters: all are fixed; leave at least one free")
    values = parameter_values(twin.scene, names)
    chosen = {name: default_parameter(name, start=float(v)) for name, v in zip(names, values, strict=True)}
    for name, (mean, sigma) in (priors or {}).items():
        if name not in chosen:
            raise InputError(f"priors: {name!r} is not free; free are {', '.join(names)}")
        if not sigma > 0:
            raise InputError(f"priors: {name}: got sigma {sigma}; expected a positive number")
        chosen[name] = replace(chosen[name], prior_mean=float(mean), prior_sigma=float(sigma))
    return tuple(chosen.values())


def with_free_friction(twin: Twin) -> Twin:
    """The twin with a rough floor if its own is frictionless: friction can be fitted from this start."""
    obstacles = tuple(o if o.friction else replace(o, friction=_FRICTION_START) for o in twin.scene.obstacles)
    if not obstacles:
        raise InputError("free: got 'friction', but the capture has no floor; give it one in capture.json")
    return twin.with_scene(obstacles=obstacles)


def start_motion(twin: Twin, observations: MarkerObservations) -> Twin:
    """The twin with the initial velocity and spin of the first four frames, where the capture states none.

    Rigid motion about the centre of mass: least squares on the marker displacements minus ½ g t².
    """
    capture, scene = twin.capture, twin.scene
    if twin.clamp is not None or (
        capture.initial_velocity is not None and capture.initial_angular_velocity is not None
    ):
        return twin
    body = scene.body
    center = body.first_moments @ scene.start / body.total_mass
    count = min(_FIRST, len(observations.positions))
    rows, target = [], []
    gravity = np.asarray(scene.gravity, dtype=np.float64)
    for frame in range(1, count):
        seen = np.isfinite(observations.positions[frame]).all(-1)
        time = frame / twin.fps
        for point, now in zip(observations.points[seen], observations.positions[frame][seen], strict=True):
            rows.append(time * np.hstack([np.eye(3), np.cross(np.eye(3), point - center).T]))
            target.append(now - point - 0.5 * gravity * time**2)
    if len(rows) < 3:
        return twin
    weight = 1e-3 * np.hstack([np.zeros(3), np.full(3, np.ptp(observations.points) / twin.fps)])
    matrix = np.vstack([*rows, np.diag(weight)])
    motion = np.linalg.lstsq(matrix, np.concatenate([*target, np.zeros(6)]), rcond=None)[0]
    found = {"initial_velocity": tuple(motion[:3]), "initial_angular_velocity": tuple(motion[3:])}
    return twin.with_scene(**{name: value for name, value in found.items() if getattr(capture, name) is None})
