"""Vibrations of the observed and the modelled body, and their difference in impulse and work."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Float

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.search.damped_sine import damped_sine_fit, deformation
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.thresholds import EVIDENCE, LOCALISATION
from physconvex.identify import MarkerObservations


@dataclass(frozen=True)
class Mode:
    """One shape of the observed deformation, and its vibration.

    Attributes:
        share: share of the squares of the observed deformation.
        observed, base, improved: (frequency [Hz], damping ratio) of the recording, of the base model, and of the model
            with the best effects; NaN if the signal is no damped sine.
        errors: standard errors of the observed pair.
    """

    share: float
    observed: tuple[float, float]
    errors: tuple[float, float]
    base: tuple[float, float]
    improved: tuple[float, float]


def vibrations(base: Baseline, best: Hypothesis) -> tuple[Mode, ...]:
    """Shapes of the observed deformation and their vibrations, from markers that are seen in every frame.

    For a free body, from the first contact on.
    """
    seen = base.observations
    if not isinstance(seen, MarkerObservations):
        return ()
    points = np.flatnonzero(np.isfinite(seen.positions).all((0, 2)))
    held = base.situation.clamped
    start = 0 if held else base.first_contact or 0
    if len(points) < (1 if held else 4) or base.model.frames - start < EVIDENCE.ringing_frames:
        return ()
    rest = base.motion.rest[points]
    observed, plain, improved = (
        deformation(p[start:, points], rest, held).reshape(base.model.frames - start, -1)
        for p in (seen.positions, base.positions, best.positions)
    )
    mean = observed.mean(0)
    _, strengths, shapes = np.linalg.svd(observed - mean, full_matrices=False)
    shares = strengths**2 / max(float((strengths**2).sum()), 1e-300)
    fps, out = base.capture.fps, []
    for share, shape in zip(shares[: LOCALISATION.shapes], shapes, strict=False):
        if share < LOCALISATION.shape_share:
            break
        found, errors = damped_sine_fit((observed - mean) @ shape, fps)
        modelled = [damped_sine_fit((motion - mean) @ shape, fps)[0] for motion in (plain, improved)]
        out.append(Mode(float(share), found, errors, *modelled))
    return tuple(out)


@dataclass(frozen=True)
class Entry:
    """One phase of the motion.

    Attributes:
        phase: its name.
        frames: first and last.
        impulse: impulse on the observed body less that on the model's [N s], shape [3].
        angular_impulse: the same about its centre [N m s], shape [3].
        work: gain of kinetic and potential energy of its rigid motion beyond the model's [J].
        impulse_error: standard error of each component of the impulse [N s], from the noise.
    """

    phase: str
    frames: tuple[int, int]
    impulse: tuple[float, ...]
    angular_impulse: tuple[float, ...]
    work: float
    impulse_error: float


def _rigid_motion(positions: Float[np.ndarray, "T P 3"], fps: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre [T, 3], its velocity and the spin [T, 3] of a cloud of points, by central differences of the points."""
    velocity = np.gradient(positions, 1 / fps, axis=0)
    centre, mean = positions.mean(1), velocity.mean(1)
    spin = np.empty_like(centre)
    for t in range(len(positions)):
        arm, speed = positions[t] - centre[t], velocity[t] - mean[t]
        inertia = (arm**2).sum() * np.eye(3) - arm.T @ arm
        spin[t] = np.linalg.lstsq(inertia, np.cross(arm, speed).sum(0), rcond=1e-9)[0]
    return centre, mean, spin


def impulses(base: Baseline, phases: tuple[str, ...]) -> tuple[Entry, ...]:
    """The ledger of a free body with markers; empty otherwise.

    The markers' centre stands for the body's; its inertia is that of the rest shape, averaged over directions.
    """
    seen = base.observations
    if not isinstance(seen, MarkerObservations) or base.situation.clamped:
        return ()
    points = np.flatnonzero(np.isfinite(seen.positions).all((0, 2)))
    if len(points) < 4 or base.model.frames < 4:
        return ()
    mesh, fps = base.model.twin.mesh, base.capture.fps
    mass = base.capture.density * float(np.abs(mesh.element_volumes).sum())
    cells, volumes = mesh.vertices[mesh.corner_tets].mean(1), np.abs(mesh.element_volumes)
    middle = volumes @ cells / volumes.sum()
    inertia = base.capture.density * float(volumes @ ((cells - middle) ** 2).sum(1)) * 2 / 3
    real, model = (_rigid_motion(p[:, points], fps) for p in (seen.positions, base.positions))
    gravity = np.asarray(base.capture.gravity)
    energy = [
        0.5 * mass * (v**2).sum(1) + 0.5 * inertia * (w**2).sum(1) - mass * (c - c[0]) @ gravity
        for c, v, w in (real, model)
    ]
    gain, push, turn = energy[0] - energy[1], mass * (real[1] - model[1]), inertia * (real[2] - model[2])
    sigma = float(np.median(seen.sigma[:, points]))
    error = mass * sigma * fps / np.sqrt(len(points))
    out = []
    for name, start, last in ranges_of(phases):
        impulse, angular, work = (part[last] - part[max(start - 1, 0)] for part in (push, turn, gain))
        out.append(Entry(name, (start, last), tuple(impulse.tolist()), tuple(angular.tolist()), float(work), error))
    return tuple(out)


def ranges_of(phases: Sequence[str]) -> Iterator[tuple[str, int, int]]:
    """Name, first and last frame of each phase in turn."""
    start = 0
    for name, group in groupby(phases):
        end = start + len(list(group))
        yield name, start, end - 1
        start = end
