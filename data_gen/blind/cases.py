"""Random captures for blind tests: body, motion and hidden effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, Int

from physconvex import ConvergenceError
from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene
from physconvex.gap import DEFAULT_EFFECTS, Effect, PointMotion, Situation
from physconvex.io import Boundary, Capture, Floor, Tracks
from physconvex.mesh import Embedding, TetMesh, tetrahedralize

# log-uniform dose ranges, in multiples of the screening trial dose
_MULTIPLES = (2.0, 6.0)
BLIND_EFFECTS: tuple[str, ...] = (
    "damping", "viscoelasticity", "plasticity", "heterogeneity", "anisotropy", "nonlinear_elasticity", "friction",
    "gravity_tilt", "air_drag", "wind", "initial_velocity", "initial_spin", "time_offset", "time_scale", "camera_pose",
)  # fmt: skip
SHAPES: dict[str, Callable[[np.random.Generator], trimesh.Trimesh]] = {
    "box": lambda rng: trimesh.creation.box(extents=rng.uniform(0.5, 1.0, 3)),
    "ellipsoid": lambda rng: trimesh.creation.icosphere(subdivisions=3).apply_transform(
        np.diag([*rng.uniform(0.3, 0.5, 3), 1.0])
    ),
    "capsule": lambda rng: trimesh.creation.capsule(height=rng.uniform(0.4, 0.8), radius=rng.uniform(0.18, 0.3)),
    "cylinder": lambda rng: trimesh.creation.cylinder(radius=rng.uniform(0.25, 0.5), height=rng.uniform(0.5, 1.0)),
}


@dataclass(frozen=True)
class HiddenEffect:
    """A hidden effect: its label in the dictionary and its doses."""

    name: str
    label: str
    doses: tuple[float, ...]
    units: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Case:
    """One capture before its simulation.

    Attributes:
        kind: drop, throw or clamped.
        surface: closed surface at t = 0 [m].
        youngs_modulus, poisson_ratio, density: material.
        height: height of the lowest point above the floor [m]; None without a floor.
        velocity, spin: initial motion [m/s], [rad/s].
        states_motion: whether the capture states the initial motion.
        clamped: box that is held [m], shape [2, 3].
        fps: frames per second.
        frames: number of frames.
        hidden: effects.
        noise: standard deviation of markers [m].
        seed: seed of markers and noise.
    """

    kind: str
    surface: trimesh.Trimesh
    youngs_modulus: float
    poisson_ratio: float
    density: float
    height: float | None
    velocity: tuple[float, float, float]
    spin: tuple[float, float, float]
    states_motion: bool
    clamped: Float[np.ndarray, "2 3"] | None
    fps: float
    frames: int
    hidden: tuple[HiddenEffect, ...]
    noise: float
    seed: int

    @property
    def size(self) -> float:
        """Largest edge of the bounding box [m]."""
        return float(np.ptp(self.surface.vertices, axis=0).max())

    def held(self, mesh: TetMesh) -> Int[np.ndarray, " H"] | None:
        """Nodes in the clamped box; None without one."""
        if self.clamped is None:
            return None
        return np.flatnonzero(((mesh.vertices >= self.clamped[0]) & (mesh.vertices <= self.clamped[1])).all(1))

    @property
    def situation(self) -> Situation:
        """Situation that sets the trial doses."""
        stress = self.density * 9.81 * self.size * 3
        return Situation(
            self.size, self.youngs_modulus, self.density, self.fps, self.frames, floor=self.height is not None,
            clamped=self.clamped is not None, touches=self.height is not None, peak_stress=stress,
        )  # fmt: skip


def _drawn_effect(rng: np.random.Generator, name: str, situation: Situation) -> HiddenEffect:
    variants = [e for e in DEFAULT_EFFECTS if e.name == name]
    effect = variants[int(rng.integers(len(variants)))]
    scale = float(np.exp(rng.uniform(*np.log(_MULTIPLES))))
    doses = effect.null.copy()
    for index, dose in enumerate(effect.doses):
        trial = dose.trial(situation)
        if dose.shape:
            doses[index] += trial + dose.smallest * rng.uniform(-1, 1)
        elif name == "plasticity":
            doses[index] += trial - np.log10(scale) / 2
        else:
            sign = 1.0 if dose.sign else rng.choice([-1.0, 1.0])
            doses[index] += scale * trial * sign * (1.0 if len(effect.doses) == 1 else rng.uniform(0.3, 1.0))
    doses = np.clip(doses, [d.lower for d in effect.doses], [d.upper for d in effect.doses])
    units = tuple(d.unit for d in effect.doses)
    return HiddenEffect(name, effect.label, tuple(float(d) for d in doses), units)


def kinds_for(effects: tuple[str, ...]) -> tuple[str, ...]:
    """Motions in which all of these effects can show."""
    kinds: tuple[str, ...] = ("drop", "throw", "clamped")
    if {"initial_velocity", "initial_spin", "air_drag", "wind", "friction", "restitution"} & set(effects):
        kinds = ("drop", "throw")
    if "attached_mass" in effects:
        kinds = tuple(kind for kind in kinds if kind == "clamped")
    return kinds


def draw_case(seed: int, effects: tuple[str, ...], *, dosed: bool = True) -> Case:
    """A capture drawn from a seed whose motion can show these effects (none: an effect-free one), and their doses."""
    rng = np.random.default_rng(seed)
    kinds = kinds_for(effects)
    kind = str(rng.choice(kinds))
    name = str(rng.choice(sorted(SHAPES)))
    surface = SHAPES[name](rng) if kind != "clamped" else trimesh.creation.box(extents=(1.0, 0.25, 0.25))
    size = float(np.exp(rng.uniform(*np.log((0.15, 0.8)))))
    surface.apply_scale(size / np.ptp(surface.vertices, axis=0).max())
    stiffness = float(np.exp(rng.uniform(*np.log((12.0, 120.0))))) * (4 if kind == "clamped" else 1)
    modulus, time = stiffness * 1000 * 9.81 * size, float(np.sqrt(size / 9.81))
    case = Case(
        kind=kind,
        surface=surface,
        youngs_modulus=modulus,
        poisson_ratio=float(rng.uniform(0.2, 0.45)),
        density=1000.0,
        height=None if kind == "clamped" else float(rng.uniform(0.1, 0.6)) * size,
        velocity=(0.0, 0.0, 0.0),
        spin=(0.0, 0.0, 0.0),
        states_motion=kind != "throw" or bool({"initial_velocity", "initial_spin"} & set(effects)),
        clamped=None,
        fps=float(np.round(8 / time)),
        frames=18,
        hidden=(),
        noise=5e-4 * size,
        seed=seed,
    )
    if kind == "throw":
        speed = size / time
        case = replace(
            case,
            velocity=(float(rng.uniform(-0.6, 0.6) * speed), float(rng.uniform(-0.6, 0.6) * speed), 0.0),
            spin=tuple(float(w) for w in rng.uniform(-1, 1, 3) / time),  # type: ignore[arg-type]
        )
    if kind == "clamped":
        low = surface.vertices.min(0)
        high = surface.vertices.max(0)
        box = np.array([low - 0.02 * size, [low[0] + 0.04 * size, high[1] + 0.02 * size, high[2] + 0.02 * size]])
        case = replace(case, clamped=box)
    if not dosed:
        return case
    return replace(case, hidden=tuple(_drawn_effect(rng, name, case.situation) for name in effects))


def _effect(hidden: HiddenEffect) -> Effect:
    return next(e for e in DEFAULT_EFFECTS if e.label == hidden.label)


def _mesh(case: Case, nodes: int) -> TetMesh:
    pair = (np.asarray(case.surface.vertices, dtype=np.float64), np.asarray(case.surface.faces))
    return tetrahedralize(pair, max_nodes=nodes, order=2, method="auto")


def _scene(case: Case, mesh: TetMesh) -> Scene:
    body = ElasticBody(mesh, youngs_modulus=case.youngs_modulus, poisson_ratio=case.poisson_ratio, density=case.density)
    obstacles = () if case.height is None else (Plane(point=(0, 0, float(floor_height(case))), friction=0.0),)
    held = case.held(mesh)
    return Scene(
        body, obstacles=obstacles, node_pins=None if held is None else NodePins(held),
        initial_velocity=case.velocity, initial_angular_velocity=case.spin,
        contact_stiffness=90.0 * case.youngs_modulus / mesh.size, contact_smoothing=2e-4 * mesh.size,
    )  # fmt: skip


def floor_height(case: Case) -> float:
    """Height of the floor of a case that has one [m]."""
    assert case.height is not None
    return float(case.surface.vertices[:, 2].min()) - case.height


def simulate_case(case: Case, *, nodes: int = 450, rate: float = 500.0) -> tuple[PointMotion, Float[np.ndarray, "P 3"]]:
    """Simulate with effects on the full-order model; return the observed positions of 40 surface points.

    Raises:
        ConvergenceError: the simulation fails.
    """
    mesh = _mesh(case, nodes)
    scene: Any = _scene(case, mesh)
    end, ahead, every = (case.frames - 1) / case.fps, 0.0, max(8, int(np.ceil(rate / case.fps)))
    for hidden in case.hidden:
        effect = _effect(hidden)
        if effect.scene is not None:
            scene = effect.scene(scene, np.array(hidden.doses))
        if effect.ahead is not None:
            ahead = max(ahead, effect.ahead(end, np.array(hidden.doses)))
    timing = Timing(frames=case.frames, fps=case.fps, steps_per_frame=every)
    run = simulate(scene, timing.every_step(ahead))
    rng = np.random.default_rng([case.seed, 1])
    points, _ = trimesh.sample.sample_surface_even(case.surface, 40, seed=int(rng.integers(2**31)))
    if len(points) < 10:
        raise ConvergenceError("markers: too few points on the surface")
    embedding = Embedding.of_points(mesh, np.asarray(points))
    steps = PointMotion(points, run.times, embedding.apply(run.positions), embedding.apply(run.velocities))
    motion = PointMotion.of_steps(steps, case.frames, every)
    positions = motion.positions
    for hidden in case.hidden:
        effect = _effect(hidden)
        if effect.observe is not None:
            positions = effect.observe(replace(motion, positions=positions), np.array(hidden.doses))
    return motion, positions


def capture_parts(
    case: Case, positions: np.ndarray, points: np.ndarray, folder: Path
) -> tuple[Capture, dict[str, Any]]:
    """The capture and the arguments of `save_capture`: all that a diagnosis may read."""
    rng = np.random.default_rng([case.seed, 2])
    noisy = positions + case.noise * rng.normal(size=positions.shape)
    floor = None
    if case.height is not None:
        floor = Floor(np.array([0.0, 0.0, floor_height(case)]), np.array([0.0, 0.0, 1.0]))
    stated = case.states_motion
    capture = Capture(
        folder=folder, fps=case.fps, frames=case.frames, observed_frames=2 * case.frames // 3, density=case.density,
        floor=floor, initial_velocity=np.array(case.velocity) if stated else None,
        initial_angular_velocity=np.array(case.spin) if stated else None,
    )  # fmt: skip
    tracks = Tracks(rest=np.asarray(points), positions=noisy, sigma=np.full(noisy.shape[:2], case.noise))
    parts: dict[str, Any] = {"mesh": trimesh.Trimesh(case.surface.vertices, case.surface.faces), "tracks": tracks}
    if case.clamped is not None:
        parts["boundary"] = Boundary(clamped_box=case.clamped)
    return capture, parts
