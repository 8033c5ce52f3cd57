"""Blind captures by the explicit engine, with doses scaled to a requested visibility of the effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from data_gen.blind.cases import Case, HiddenEffect, floor_height
from data_gen.blind.engine import ExplicitWorld, run_explicit
from data_gen.objects.solids import random_direction
from physconvex import ConvergenceError
from physconvex.gap import PointMotion, rotation_vector_matrix, with_plane
from physconvex.mesh import TetMesh, linear_part, tetrahedralize

Positions = Float[np.ndarray, "T P 3"]
Observe = Callable[[PointMotion], Positions]
_MARKERS, _ROUNDS, _NEAR = 40, 5, 0.4
_LEAST, _MOST = 0.5, 3.0  # factors on the requested visibility
_STIFFER, _WIDER, _FASTER = 1.05, 0.02, 0.02  # changes: factor on E, of ν, velocity over a fall by size
_HARDER = 2.0  # factor on the contact stiffness; its effect estimates the error that the floor's give leaves
_ORDER = 1.5  # convergence order by edge length: linear elements, smoothed, and contact
_WEAKEST, _STRONGEST = 0.02, 8.0  # multiples of a moderate dose
_SOFT_CONTACT = 12.0  # contact modulus over E/size, of runs with an intended numerical error
_NODES = (250, 2000)  # mesh sizes for the search of the dose, and for the capture
OUTSIDE = ("tether",)  # in no dictionary
EXPLICIT_EFFECTS: tuple[str, ...] = (
    "damping", "viscoelasticity", "plasticity", "heterogeneity", "anisotropy", "nonlinear_elasticity", "friction",
    "restitution", "gravity_tilt", "air_drag", "wind", "attached_mass", "initial_velocity", "initial_spin",
    "time_offset", "time_scale", "camera_pose",
)  # fmt: skip


@dataclass(frozen=True)
class Dosed:
    """An effect at one strength: change of the world, change of the observation, label, and arguments of the clock.

    The arguments of the clock are those of `run_explicit`.
    """

    world: Callable[[ExplicitWorld], ExplicitWorld] | None
    observe: Observe | None
    doses: tuple[float, ...]
    units: tuple[str, ...]
    late: float = 0.0
    fast: float = 0.0


def _world_effect(name: str, s: float, case: Case, rng: np.random.Generator) -> Dosed:
    """Effects of the dynamics; `s` = 1 is moderate."""
    size, modulus = case.size, case.youngs_modulus
    wave, speed = size * np.sqrt(case.density / modulus), np.sqrt(9.81 * size)
    fields: dict[str, Any] = {}
    doses: tuple[float, ...] = ()
    units: tuple[str, ...] = ("",)
    if name == "damping":
        doses, units = (0.1 * wave * s,), ("s",)
        fields = {"damping_time": doses[0]}
    elif name == "viscoelasticity":
        doses, units = (0.4 * s, wave * float(np.exp(rng.uniform(-2, 0)))), ("", "s")
        fields = {"branch": doses}
    elif name == "plasticity":
        doses, units = (case.density * 9.81 * size * (3.0 if case.clamped is None else 6.0) / s,), ("Pa",)
        fields = {"yield_stress": doses[0]}
    elif name == "nonlinear_elasticity":
        doses = (1.0 * s,)
        fields = {"stiffening": doses[0]}
    elif name == "anisotropy":
        along = random_direction(rng)
        doses, units = (0.5 * s, *along), ("", "", "", "")
        fields = {"fibre": (doses[0], along)}
    elif name == "friction":
        doses = (0.15 * s,)
        fields = {"friction": doses[0]}
    elif name == "restitution":
        doses, units = (0.2 * wave * s,), ("s",)
        fields = {"contact_damping": doses[0]}
    elif name == "air_drag":
        doses, units = (0.05 * s / size,), ("1/m",)
        fields = {"drag_rate": doses[0]}
    elif name == "wind":
        along = random_direction(rng, 2)
        air = float(np.sqrt(0.03 * s * 9.81 * case.density * size / 2 / 0.9))
        doses, units = (air * along[0], air * along[1]), ("m/s", "m/s")
        fields = {"wind": (0.15, (doses[0], doses[1], 0.0))}
    elif name == "gravity_tilt":
        along = np.radians(2.0 * s) * random_direction(rng, 2)
        turned = rotation_vector_matrix(np.array([*along, 0.0])) @ np.array([0, 0, -9.81])
        doses, units = tuple(np.degrees(along)), ("deg", "deg")
        fields = {"gravity": tuple(turned)}
    elif name == "initial_velocity":
        doses, units = tuple(0.05 * s * speed * random_direction(rng)), ("m/s",) * 3
        fields = {"velocity": tuple(np.array(case.velocity) + doses)}
    elif name == "initial_spin":
        doses, units = tuple(0.2 * s * speed / size * random_direction(rng)), ("rad/s",) * 3
        fields = {"spin": tuple(np.array(case.spin) + doses)}
    else:
        return _field_effect(name, s, case, rng)
    return Dosed(lambda world: replace(world, **fields), None, tuple(float(d) for d in doses), units)


def _field_effect(name: str, s: float, case: Case, rng: np.random.Generator) -> Dosed:
    """Effects that need the mesh (an inclusion, a load at the free end, a tether), and one that needs time."""
    low, high, size = case.surface.vertices.min(0), case.surface.vertices.max(0), case.size
    if name == "heterogeneity":
        centre = low + (high - low) * rng.uniform(0.15, 0.85, 3)
        decades = float(rng.choice([-1.0, 1.0])) * min(0.4 * s, 1.5)
        radius = 0.4 * (high - low)

        def stiffer(world: ExplicitWorld) -> ExplicitWorld:
            cells = world.mesh.vertices[world.mesh.tets[:, :4]].mean(1)
            inside = (((cells - centre) / radius) ** 2).sum(1) < 1
            return replace(world, youngs_modulus=np.asarray(world.youngs_modulus) * np.where(inside, 10**decades, 1.0))

        return Dosed(stiffer, None, (decades, *centre), ("decades", "m", "m", "m"))
    if name == "attached_mass":
        ratio = 0.3 * s

        def loaded(world: ExplicitWorld) -> ExplicitWorld:
            x = world.mesh.vertices[:, 0]
            end = x > x.max() - 0.12 * np.ptp(x)
            mass = world.density * float(np.abs(world.mesh.element_volumes).sum())
            return replace(world, extra_mass=np.where(end, ratio * mass / end.sum(), 0.0))

        return Dosed(loaded, None, (ratio,), ("",))
    if name == "tether":  # a soft spring between one side of the body and its initial place
        side = random_direction(rng)

        def tied(world: ExplicitWorld) -> ExplicitWorld:
            x = world.mesh.vertices @ side
            end = x > np.quantile(x, 0.8)
            mass = world.density * float(np.abs(world.mesh.element_volumes).sum())
            return replace(world, tied=np.where(end, 0.3 * s * mass * 9.81 / size / end.sum(), 0.0))

        return Dosed(tied, None, (0.3 * s, *side), ("m g / size", "", "", ""))
    raise AssertionError(name)


def _seen_effect(name: str, s: float, case: Case, rng: np.random.Generator) -> Dosed:
    """Effects of the observation of markers."""
    if name == "time_offset":
        late = 0.25 * s / case.fps
        return Dosed(None, None, (late,), ("s",), late=late)
    if name == "time_scale":
        change = 0.03 * s * float(rng.choice([-1.0, 1.0]))
        return Dosed(None, None, (change,), ("",), fast=change)
    turn, shift = np.radians(1.0 * s) * random_direction(rng), 0.01 * s * case.size * random_direction(rng)
    matrix = rotation_vector_matrix(turn)

    def moved(motion: PointMotion) -> Positions:  # about the mean of the markers, as in the dictionary
        pivot = motion.rest.mean(0)
        return np.asarray((motion.positions - pivot) @ matrix.T + pivot + shift)

    return Dosed(None, moved, (*np.degrees(turn), *shift), ("deg",) * 3 + ("m",) * 3)


def _dosed(name: str, s: float, case: Case, seed: int) -> Dosed:
    rng = np.random.default_rng([case.seed, seed])
    if name in ("time_offset", "time_scale", "camera_pose"):
        return _seen_effect(name, s, case, rng)
    return _world_effect(name, s, case, rng)


def _mesh(case: Case, nodes: int) -> TetMesh:
    if case.clamped is not None:  # a bar along x: exactly the part inside the box is held
        low, high = case.surface.vertices.min(0), case.surface.vertices.max(0)
        edge = float(np.cbrt(np.prod(high - low) / nodes))
        cells = tuple(int(np.ceil(e / edge)) for e in high - low)
        return with_plane(low, high, (cells[0], cells[1], cells[2]), 0, float(case.clamped[1, 0]), order=1)
    pair = (np.asarray(case.surface.vertices, dtype=np.float64), np.asarray(case.surface.faces))
    return linear_part(tetrahedralize(pair, max_nodes=7 * nodes, order=2, method="auto"))


def _world(case: Case, mesh: TetMesh) -> ExplicitWorld:
    return ExplicitWorld(
        mesh, case.youngs_modulus, case.poisson_ratio, case.density, velocity=case.velocity, spin=case.spin,
        floor=None if case.height is None else floor_height(case), held=case.held(mesh),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Runner:
    case: Case
    mesh: TetMesh
    points: np.ndarray

    def __call__(self, *effects: Dosed, **changes: Any) -> tuple[PointMotion, Positions]:
        world = replace(_world(self.case, self.mesh), **changes)
        for effect in effects:
            world = world if effect.world is None else effect.world(world)
        motion = run_explicit(
            world, self.points, frames=self.case.frames, fps=self.case.fps,
            late=sum(effect.late for effect in effects), fast=sum(effect.fast for effect in effects),
        )  # fmt: skip
        positions = motion.positions
        for effect in effects:
            if effect.observe is not None:
                positions = effect.observe(replace(motion, positions=positions))
        return motion, positions


def simulate_explicit(
    case: Case, names: tuple[str, ...], visibility: float, *, rough: bool = False
) -> tuple[PointMotion, Positions, Case, float]:
    """Simulate with effects that each reach a requested visibility.

    Args:
        case: case without effects.
        names: names of the effects.
        visibility: mean square change by each effect over that of noise and numerical error, see `_Yardstick`.
        rough: whether a coarse mesh and a contact one fifth as stiff cause a numerical error in place of an effect.

    Returns:
        Motion and observed positions of 40 surface points on the fine mesh, the case with its effects, its visibility.

    Raises:
        ConvergenceError: a run diverges, or no dose reaches the visibility.
    """
    rng = np.random.default_rng([case.seed, 1])
    points, _ = trimesh.sample.sample_surface_even(case.surface, _MARKERS, seed=int(rng.integers(2**31)))
    points = np.asarray(points)
    coarse, fine = (_Runner(case, _mesh(case, nodes), points) for nodes in _NODES)
    if rough:
        return *coarse(contact_modulus=_SOFT_CONTACT), case, 0.0
    if not names:
        return *fine(), case, 0.0
    yardstick = _Yardstick.of(case, coarse, fine)
    chosen, reached = [], []
    for number, name in enumerate(names):
        found, dose = _scaled(name, case, coarse, yardstick, visibility=visibility, number=number)
        chosen.append((name, dose))
        reached.append(found)
    motion, positions = fine(*(dose for _, dose in chosen))
    hidden = tuple(HiddenEffect(name, name, dose.doses, dose.units) for name, dose in chosen)
    return motion, positions, replace(case, hidden=hidden), float(min(reached))


@dataclass(frozen=True, eq=False)
class _Yardstick:
    """Visibility of a change of the observed positions.

    E, ν and the initial motion (if the capture does not state it) are fitted, so the part of a change that they can
    absorb does not count. The mean square of the rest is compared with that of noise and numerical error. The numerical
    error is the change by a finer mesh, extrapolated, and by a contact twice as stiff, after the same absorption.

    Attributes:
        start: observed positions without effects [m], shape [T, P, 3].
        absorbing: orthonormal changes by the fitted parameters, shape [T P 3, K].
        floor: mean square of noise and numerical error [m²].
    """

    start: Positions
    absorbing: Float[np.ndarray, "N K"]
    floor: float

    @classmethod
    def of(cls, case: Case, coarse: _Runner, fine: _Runner) -> _Yardstick:
        """Build from runs without effects.

        Raises:
            ConvergenceError: one of the runs diverges.
        """
        start = coarse()[1]
        free: list[dict[str, Any]] = [
            {"youngs_modulus": _STIFFER * case.youngs_modulus}, {"poisson_ratio": case.poisson_ratio + _WIDER}
        ]  # fmt: skip
        if not case.states_motion:
            speed = _FASTER * float(np.sqrt(9.81 * case.size))
            free += [{"velocity": tuple(np.array(case.velocity) + speed * axis)} for axis in np.eye(3)]
            free += [{"spin": tuple(np.array(case.spin) + speed / case.size * axis)} for axis in np.eye(3)]
        changes = np.stack([(coarse(**fields)[1] - start).ravel() for fields in free], axis=1)
        still = cls(start, np.linalg.qr(changes / np.linalg.norm(changes, axis=0))[0], 0.0)
        ratio = (len(fine.mesh.vertices) / len(coarse.mesh.vertices)) ** (_ORDER / 3)
        errors = [(fine()[1] - start) / (ratio - 1)]
        if case.height is not None:
            errors.append(coarse(contact_modulus=_HARDER * ExplicitWorld.contact_modulus)[1] - start)
        return replace(still, floor=3 * case.noise**2 + sum(still.left(error) for error in errors))

    def left(self, change: Positions) -> float:
        """Mean square of the part that is not absorbed [m²]."""
        flat = change.ravel()
        flat = flat - self.absorbing @ (self.absorbing.T @ flat)
        return float((flat**2).sum()) / (flat.size / 3)

    def visibility(self, positions: Positions) -> float:
        """Visibility of a set of observed positions."""
        return self.left(positions - self.start) / self.floor


def _scaled(
    name: str, case: Case, runner: _Runner, yardstick: _Yardstick, *, visibility: float, number: int
) -> tuple[float, Dosed]:
    """The dose at which an effect reaches the requested visibility, and the visibility there.

    The search scales the strength by the square root of the missing factor, or bisects between a weaker and a stronger
    trial. Bisection is needed because a yield stress changes nothing below its threshold.
    """
    strength, weaker, stronger = 1.0, 0.5 * _WEAKEST, 2 * _STRONGEST
    tried: list[tuple[float, Dosed]] = []
    for _ in range(_ROUNDS):
        dose = _dosed(name, strength, case, number + 7)
        seen = max(yardstick.visibility(runner(dose)[1]), 1e-9)
        tried.append((seen, dose))
        if abs(np.log(seen / visibility)) < _NEAR:
            break
        weaker, stronger = (strength, stronger) if seen < visibility else (weaker, strength)
        following = strength * float(np.clip(np.sqrt(visibility / seen), 0.2, 5.0))
        if not weaker < following < stronger:
            following = float(np.sqrt(weaker * stronger))
        following = float(np.clip(following, _WEAKEST, _STRONGEST))
        if following == strength:  # at the weakest or strongest limit
            break
        strength = following
    best = min(tried, key=lambda t: abs(np.log(t[0] / visibility)))
    if not _LEAST <= best[0] / visibility <= _MOST:
        raise ConvergenceError(
            f"{name}: {best[0]:.1f} times as large as noise and numerical error, in mean square; {visibility:g} wanted"
        )
    return best
