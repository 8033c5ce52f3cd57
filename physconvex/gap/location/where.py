"""Location of a gap: sources, phases of the motion, frames, and regions of the body, each with an interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.location.body_motion import Entry, Mode, impulses, vibrations
from physconvex.gap.location.sources import budget_of, reduction_by_frame, squares_by_frame
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.identify import PixelObservations


@dataclass(frozen=True)
class Part:
    """A part of the gap: rms [m] (square root of its mean square) and its interval."""

    name: str
    value: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Where:
    """The decomposition.

    Attributes:
        sources: see `physconvex.gap.location.sources`; mean squares add up.
        reduction: additional error of the reduced twin; None if it is not run.
        phases: gap of the base model by phase of the motion.
        regions: by region of the body.
        image: by ninth of the picture [m at the points' depth]; empty for markers.
        modes: vibrations of the body, see `physconvex.gap.location.body_motion`.
        ledger: impulse and work beyond the base model, see `physconvex.gap.location.body_motion`.
        times: times of the frames [s], shape [T].
        phase_names: phase of each frame.
        per_frame: gap of the base model [m], shape [T]; NaN if nothing is seen.
        per_frame_after: with the best effects [m], shape [T].
        per_frame_floor: expected gap from noise and numerical error [m], shape [T].
        points: rest positions of the observed points [m], shape [P, 3].
        per_point: gap of the base model at the points [m], shape [P].
        vertices: vertices of the model's mesh [m], shape [V, 3].
        faces: its surface, shape [F, 3].
        per_vertex: the gap interpolated to the vertices [m], shape [V].
    """

    sources: tuple[Part, ...]
    reduction: Part | None
    phases: tuple[Part, ...]
    regions: tuple[Part, ...]
    image: tuple[Part, ...]
    modes: tuple[Mode, ...]
    ledger: tuple[Entry, ...]
    times: Float[np.ndarray, " T"]
    phase_names: tuple[str, ...]
    per_frame: Float[np.ndarray, " T"]
    per_frame_after: Float[np.ndarray, " T"]
    per_frame_floor: Float[np.ndarray, " T"]
    points: Float[np.ndarray, "P 3"]
    per_point: Float[np.ndarray, " P"]
    vertices: Float[np.ndarray, "V 3"]
    faces: np.ndarray
    per_vertex: Float[np.ndarray, " V"]


def phases_of(force: Float[np.ndarray, " T"], speed: Float[np.ndarray, " T"]) -> tuple[str, ...]:
    """Phase of each frame from the model's normal force [N] and mean speed of the points [m/s].

    flight; impact until the force peaks; contact until lift-off; rebound in the air again; rest in contact and nearly
    stopped. A body that never touches is in motion, early and late.
    """
    count = len(force)
    if not (force > 0).any():
        return tuple("early motion" if i < count / 2 else "late motion" for i in range(count))
    names, slow = [], 0.05 * max(float(speed.max()), 1e-12)
    touched, previous = False, 0.0
    for now, fast in zip(force, speed, strict=True):
        if now <= 0:
            names.append("rebound" if touched else "flight")
        elif touched and fast < slow:
            names.append("rest")
        else:
            names.append("impact" if now >= previous else "contact")
        touched, previous = touched or now > 0, now
    return tuple(names)


def block_bootstrap(values: np.ndarray, statistic_count: int, options: GapOptions) -> Float[np.ndarray, "B K"]:
    """Means over resampled blocks of frames (moving blocks of T^(1/3) frames, two if there are enough)."""
    rng = np.random.default_rng(options.seed)
    rows = np.asarray(values).reshape(len(values), statistic_count)
    length = max(1, min(max(2, round(len(rows) ** (1 / 3))), len(rows) // 2))
    blocks = int(np.ceil(len(rows) / length))
    starts = rng.integers(0, len(rows) - length + 1, size=(options.bootstraps, blocks))
    index = (starts[:, :, None] + np.arange(length)).reshape(options.bootstraps, -1)[:, : len(rows)]
    return np.asarray(rows[index].mean(1))


def _part(name: str, squares: np.ndarray, options: GapOptions) -> Part:
    tail = (1 - options.confidence) / 2
    squares = squares[np.isfinite(squares)]
    if not len(squares):
        return Part(name, 0.0, 0.0, 0.0)
    draws = block_bootstrap(squares, 1, options)[:, 0]
    low, high = np.quantile(draws, [tail, 1 - tail])
    root = np.sqrt(np.maximum([squares.mean(), low, high], 0.0))
    return Part(name, float(root[0]), float(root[1]), float(root[2]))


def locate_gap(base: Baseline, errors: ErrorModel, best: Hypothesis, options: GapOptions) -> Where:
    """Decompose the gap of the base model."""
    observations = base.observations
    before = base.missed(base.positions) ** 2
    total, left = squares_by_frame(base, before), squares_by_frame(base, base.missed(best.positions) ** 2)
    floor = squares_by_frame(base, errors.expected * base.lengths**2)
    reduction = reduction_by_frame(base)
    speed = np.linalg.norm(base.motion.velocities, axis=-1).mean(1)
    phases = phases_of(base.contact_force, speed)
    order = list(dict.fromkeys(phases))
    by_point = np.bincount(observations.point_indices, before, minlength=len(observations.points))
    seen = np.maximum(np.bincount(observations.point_indices, minlength=len(observations.points)), 1)
    per_point = np.sqrt(base.components * by_point / seen)
    mesh = base.model.twin.mesh
    return Where(
        sources=tuple(_part(name, squares, options) for name, squares in budget_of(base, errors, best).items()),
        reduction=None if reduction is None else _part("reduction", reduction, options),
        phases=tuple(_part(n, total[[p == n for p in phases]], options) for n in order),
        regions=_regions(base, before, options),
        image=_image(base, before, options),
        modes=vibrations(base, best),
        ledger=impulses(base, phases),
        times=base.motion.times,
        phase_names=phases,
        per_frame=np.sqrt(total),
        per_frame_after=np.sqrt(left),
        per_frame_floor=np.sqrt(floor),
        points=np.asarray(observations.points),
        per_point=per_point,
        vertices=mesh.vertices,
        faces=mesh.boundary_faces[:, :3],
        per_vertex=_spread(np.asarray(observations.points), per_point, mesh.vertices),
    )


def _image(base: Baseline, squares: np.ndarray, options: GapOptions) -> tuple[Part, ...]:
    """Gap by ninths of the picture, from the observed places of the points."""
    seen = base.observations
    if not isinstance(seen, PixelObservations):
        return ()
    pixels = seen.pixels[seen.frames, seen.point_indices]
    shares = np.clip(np.nan_to_num(3 * pixels / [seen.camera.w, seen.camera.h]).astype(int), 0, 2)
    return tuple(
        _part(f"{height} {side}", squares_by_frame(base, squares, rows), options)
        for row, height in enumerate(("top", "middle", "bottom"))
        for column, side in enumerate(("left", "centre", "right"))
        if (rows := (shares == [column, row]).all(1)).any()
    )


def _regions(base: Baseline, squares: np.ndarray, options: GapOptions) -> tuple[Part, ...]:
    """Gap by thirds of the body along its longest axis and, for a body that touches a floor, along the vertical."""
    observations = base.observations
    points = np.asarray(observations.points)
    axes = {"xyz"[int(np.ptp(base.model.twin.mesh.vertices, axis=0).argmax())]}
    if base.situation.floor:
        axes.add("z")
    out = []
    for axis in sorted(axes):
        coordinate = points[:, "xyz".index(axis)]
        low, high = coordinate.min(), coordinate.max()
        third = np.minimum((3 * (coordinate - low) / max(high - low, 1e-12)).astype(int), 2)
        for index, name in enumerate(("lowest", "middle", "highest")):
            rows = third[observations.point_indices] == index
            if rows.any():
                out.append(_part(f"{name} third along {axis}", squares_by_frame(base, squares, rows), options))
    return tuple(out)


def _spread(points: np.ndarray, values: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Values interpolated from points to vertices, by inverse square distance to the nearest four."""
    count = min(4, len(points))
    distance, nearest = cKDTree(points).query(vertices, k=[*range(1, count + 1)])
    weights = 1 / np.maximum(distance, 1e-6 * max(float(np.ptp(vertices)), 1e-12)) ** 2
    return np.asarray((weights * values[nearest]).sum(1) / weights.sum(1))
