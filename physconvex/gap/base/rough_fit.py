"""The rough fit of the base model by the reduced model, and the error of a rough model.

A rough model errs little in flight, and by a hundredth of the body's size after contact. With the stated noise for each
frame, the frames after an impact would distort the fit of the flight: a spin that ten frames of flight determine to a
tenth of a degree gets the wrong sign. Numerical differences give the errors of later fits, but need a rough fit first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Plane, simulate
from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import FLOOR_LAW, Baseline, Report, Split, split_frames
from physconvex.gap.base.body_modes import body_modes
from physconvex.gap.base.box_mesh import box_of_body
from physconvex.gap.base.cost import Cost
from physconvex.gap.base.model import MODULUS, EffectModel
from physconvex.gap.base.observed_points import (
    Seen,
    depth_seen,
    in_metres,
    observations_of,
    starts_elsewhere,
    widened,
    with_honest_noise,
)
from physconvex.gap.effects.effect import Situation
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import BASE_FIT
from physconvex.identify import (
    Fit,
    FitOptions,
    MarkerObservations,
    Parameter,
    PixelObservations,
    ReducedModel,
    Twin,
    TwinOptions,
    base_twin,
    default_parameters,
    fit,
    scan,
    scan_values,
    start_motion,
)
from physconvex.io import Capture
from physconvex.mesh import TetMesh
from physconvex.reduced import ReducedTrajectory


def with_rough_errors(seen: Seen, twin: Twin, frames: int) -> Seen:
    """Observations of the first frames, with noise widened by the error of a rough model of a free body.

    The flight of the twin must agree with the body's. Unchanged for a held body, and if the twin cannot be simulated.
    """
    seen = seen.in_frames(frames)
    if twin.clamp is not None:
        return seen
    try:
        run = simulate(twin.scene, twin.timing(frames))
    except ConvergenceError:
        return seen
    space = twin.scene.body.space
    shapes = space.shape_values(seen.points)
    camera = getattr(seen, "camera", None)
    motion = PointMotion(seen.points, run.times, shapes @ run.coordinates, shapes @ run.velocities, camera)
    error = _rough_error_by_frame(twin, run, motion)
    return widened(seen, 1.0 + (error[seen.frames] / in_metres(seen, motion)) ** 2)


def _rough_error_by_frame(twin: Twin, run: ReducedTrajectory, motion: PointMotion) -> Float[np.ndarray, " T"]:
    """Error of each frame [m], from a run of the twin and the motion of the observed points in it."""
    size, times, skinned = twin.mesh.size, run.times, twin.scene.body.space.surface_values
    surface, velocities = skinned @ run.coordinates, (skinned @ run.velocities).mean(1)
    error = BASE_FIT.flying * np.linalg.norm(motion.positions - motion.rest, axis=-1).mean(1)
    obstacles, close = twin.scene.obstacles, BASE_FIT.near * size
    pairs = zip(surface, times.tolist(), strict=True)
    near = np.array([any((obstacle.gap(x, t) < close).any() for obstacle in obstacles) for x, t in pairs])
    gravity = np.asarray(twin.scene.gravity, dtype=np.float64)
    pushed = np.linalg.norm(np.diff(velocities, axis=0) - gravity * np.diff(times)[:, None], axis=1)
    near[1:] |= pushed > BASE_FIT.pushed * np.linalg.norm(gravity) * np.diff(times)
    touched = np.flatnonzero(near)
    if len(touched) and obstacles:
        error[touched[0] :] = np.maximum(error[touched[0] :], BASE_FIT.touched * size)
    return np.asarray(error)


def _twin(capture: Capture, weights: int, max_nodes: int, steps: int) -> Twin:
    """The capture's twin on a mesh of this many nodes, or up to four times as many if the boundary needs them.

    Raises:
        InputError: the capture lacks something.
    """
    for factor in (1, 2, 4):
        chosen = TwinOptions(weights=weights, max_nodes=factor * max_nodes, steps_per_frame=steps)
        try:
            return base_twin(capture, chosen, mesh=box_of_body(capture, chosen.max_nodes))
        except InputError as error:
            if factor == 4 or not str(error).startswith("boundary"):
                raise
    raise AssertionError("unreachable")


def _first_values(twin: Twin, observations: Seen, frames: int) -> tuple[Parameter, ...]:
    """Starts of the base parameters: rigid motion from the first frames, E from a scan with a coarse twin."""
    capture = twin.capture
    if isinstance(observations, MarkerObservations):
        twin = start_motion(twin, observations)
    parameters = default_parameters(twin)
    gravity = float(np.linalg.norm(capture.gravity))
    moduli = scan_values(density=capture.density, gravity=gravity, size=twin.mesh.size)
    if isinstance(observations, MarkerObservations):
        middle = np.array([moduli[len(moduli) // 2]])
        observations = with_rough_errors(observations, twin.with_values([MODULUS], middle), frames)
    names = tuple(p.name for p in parameters)
    windows = _windows(frames, held=twin.clamp is not None)
    model = ReducedModel(twin, names, observations.points, windows[0])
    candidates = scan(model, observations.in_frames(windows[0]), parameters, moduli=moduli, ratios=(0.35,))
    tried = []
    for candidate in candidates[: BASE_FIT.starts_held if twin.clamp is not None else 1]:
        chosen = candidate.parameters
        try:
            for count in windows:  # a phase error of one period misleads the fit: begin with few frames
                model = ReducedModel(twin, names, observations.points, count)
                found = fit(model, observations.in_frames(count), chosen, options=FitOptions(max_iterations=8))
                chosen = tuple(p.at(float(v)) for p, v in zip(found.parameters, found.values, strict=True))
        except ConvergenceError:
            continue
        tried.append((found.misfit, chosen))
    if not tried:
        return candidates[0].parameters
    return min(tried, key=lambda pair: pair[0])[1]


def _windows(frames: int, *, held: bool) -> tuple[int, ...]:
    """Numbers of frames of the successive fits; held bodies vibrate from the start.

    Fewer than ten frames may show only the first fall, which is the same for any soft body.
    """
    return tuple(sorted({min(frames, max(10, frames // 2)), frames})) if held else (frames,)


def steps_per_frame(twin: Twin, values: dict[str, float]) -> int:
    """Time steps per frame that resolve the body's vibrations, within the affordable number."""
    wave = twin.mesh.size * np.sqrt(twin.capture.density / 10 ** values[MODULUS])
    resolved = BASE_FIT.steps_per_wave if twin.clamp is None else BASE_FIT.steps_per_wave_held
    wanted = int(np.ceil(resolved / (wave * twin.fps)))
    most = max(twin.steps_per_frame, BASE_FIT.most_steps // twin.capture.frames)
    return int(np.clip(wanted, twin.steps_per_frame, most))


def _situation(twin: Twin, seen: Seen, split: Split, names: Sequence[str]) -> Situation:
    """Facts about the capture; stress and touch are those of no run yet."""
    scene, capture = twin.scene, twin.capture
    return Situation(
        size=twin.mesh.size,
        youngs_modulus=float(np.mean(scene.body.youngs_modulus)),
        density=capture.density,
        fps=capture.fps,
        frames=capture.frames,
        floor=bool(scene.obstacles),
        clamped=twin.clamp is not None,
        touches=bool(scene.obstacles),
        giving_floor=bool(set(FLOOR_LAW) & set(names)),
        depth=depth_seen(capture, seen, split.fitted),
        friction=max((o.friction for o in scene.obstacles), default=0.0),
        states_velocity=capture.initial_velocity is not None or twin.clamp is not None,
        states_spin=capture.initial_angular_velocity is not None or twin.clamp is not None,
        starts_elsewhere=starts_elsewhere(seen),
        gravity=(float(capture.gravity[0]), float(capture.gravity[1]), float(capture.gravity[2])),
        camera=seen.camera if isinstance(seen, PixelObservations) else None,
    )


def _stress_and_contact(model: EffectModel, values: np.ndarray) -> tuple[float, np.ndarray, PointMotion]:
    """Peak von Mises stress [Pa] (99th percentile), normal force per frame [N], and the motion of the points."""
    motion, scene, run = model.full_motion(values)
    contact, peak, force = scene.contact(), 0.0, np.zeros(len(motion.times))
    for frame, x in enumerate(run.positions[:: model.twin.steps_per_frame]):
        stress = scene.body.stress(x).cpu().numpy()
        deviator = stress - np.trace(stress, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
        mises = np.sqrt(1.5 * (deviator**2).sum((-1, -2)))
        peak = max(peak, float(np.quantile(mises, 0.99)))
        force[frame] = np.linalg.norm(contact.energy_and_gradient(x, motion.times[frame])[1], axis=1).sum()
    return peak, force, motion


def rough_baseline(
    capture: Capture, options: GapOptions, report: Report, *, cost: Cost | None = None
) -> Baseline:  # fmt: skip
    """Fit the free parameters of the reduced base model, and run the full-order model at the result.

    `cost` counts the runs of all models derived from it, `report` receives progress messages.

    Raises:
        InputError: no tracks, no rest geometry, or too few frames.
        ConvergenceError: the base model cannot be simulated.
    """
    coarse = _twin(capture, 5, min(200, options.max_nodes), max(4, int(np.ceil(192 / capture.fps))))
    observations = with_honest_noise(observations_of(capture, coarse))
    split = split_frames(capture, observations.frames)
    count = split.end
    fitted = observations.in_frames(count)
    report("rough fit of the base model")
    starts = _first_values(coarse, fitted, count)
    values = {p.name: p.start for p in starts}
    twin = _twin(capture, options.weights, options.max_nodes, 6)
    twin = replace(twin, steps_per_frame=steps_per_frame(twin, values))
    names = tuple(values)
    twin = twin.with_values(names, np.array(list(values.values())))
    report("fit of the reduced base model")
    fitted = with_rough_errors(fitted, twin, count)
    rough = fit(ReducedModel(twin, names, fitted.points, count), fitted, starts, options=FitOptions(max_iterations=6))
    return _run_base(capture, observations, split, twin.with_values(names, rough.values), rough, cost=cost)


def run_again(base: Baseline, found: Fit, *, twin: Twin | None = None, mesh: TetMesh | None = None) -> Baseline:
    """The full-order model of a baseline at other fitted values, on its own twin by default."""
    twin = (twin or base.model.twin).with_values(found.names, found.values)
    return _run_base(base.capture, base.observations, base.split, twin, found, mesh=mesh, cost=base.model.cost)


def _run_base(
    capture: Capture, observations: Seen, split: Split, twin: Twin, found: Fit, *, mesh: TetMesh | None = None,
    cost: Cost | None = None,
) -> Baseline:  # fmt: skip
    """The full-order model at fitted values, all frames, without tangents."""
    situation = _situation(twin, observations, split, found.names)
    model = EffectModel(
        twin, found.names, np.asarray(observations.points), capture.frames, situation, camera=situation.camera,
        mesh=mesh, cost=cost or Cost(),
    )  # fmt: skip
    peak, force, motion = _stress_and_contact(model, found.values)
    situation = replace(situation, peak_stress=peak, touches=bool((force > 0).any()))
    nothing = np.zeros((capture.frames, len(found.names), *motion.positions.shape[1:]))
    floors = twin.scene.obstacles
    normal = np.asarray(floors[0].normal) if len(floors) == 1 and isinstance(floors[0], Plane) else None
    modes = body_modes(observations, free=situation.floor and not situation.clamped, force=force, normal=normal)
    return Baseline(
        capture, observations, split, replace(model, situation=situation), found, motion, nothing, situation, force,
        modes,
    )  # fmt: skip
