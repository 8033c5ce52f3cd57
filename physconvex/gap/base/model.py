"""A twin with effects: positions of points from base parameters and doses, by the full-order or the reduced model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import IntegratorName, Timing, simulate
from physconvex.errors import ConvergenceError
from physconvex.fem import Scene as FullScene, Trajectory, vibration_modes
from physconvex.gap.base.cost import Cost
from physconvex.gap.effects.effect import AnyScene, Effect, Situation
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.thresholds import BASE_FIT
from physconvex.identify import Parameter, SecantModel, Twin, default_parameter
from physconvex.io import Camera
from physconvex.mesh import Embedding, TetMesh
from physconvex.reduced import ReducedScene, parameter_values

Positions = Float[np.ndarray, "T P 3"]
Vector = Float[np.ndarray, " K"]
MODULUS: str = "log10_youngs_modulus"  # names of parameters
RATIO: str = "poisson_ratio"
_BASE_STEP = 0.1  # share of a typical step, for finite differences
# tolerances of the full-order runs: their errors stay below 1e-5 of the size, a hundredth of the mesh error
_TOLERANCE, _FRICTION_PASSES = 1e-6, 4


def accurate(timing: Timing) -> Timing:
    """Solver settings with the accuracy of a diagnosis."""
    return replace(timing, tolerance=_TOLERANCE, friction_passes=_FRICTION_PASSES)


@dataclass(frozen=True, eq=False)
class EffectModel:
    """Base parameters and doses → positions of the observed points.

    Attributes:
        twin: the base model.
        base: names of the free base parameters.
        points: rest positions of the points [m], shape [P, 3].
        frames: number of frames T.
        situation: sets the sizes of finite doses.
        effects: added effects.
        camera: the observing camera, for effects of the observation.
        directions: motions of effects that are differences of runs (numerical ones), by name, shape [T, P, 3].
        correction: change by a finer model, added to every motion.
        mesh: another mesh for the full-order model.
        refinement: factor on its number of time steps.
        integrator: integrator of the full-order model.
        doubt: factor by which the stated noise overrates the information of the fit; it increases the weight of priors,
            see `physconvex.gap.base.body_modes`.
        reduced: whether the reduced model computes the motions; `correction` then adds the difference.
        stiffer: change of log10 E in every run.
        surrogate_stiffer: the same for the cheaper model that `reduced_like` makes.
        cost: total cost of the runs of this model and of all models that `replace` makes from it.
    """

    twin: Twin
    base: tuple[str, ...]
    points: Float[np.ndarray, "P 3"]
    frames: int
    situation: Situation
    effects: tuple[Effect, ...] = ()
    camera: Camera | None = None
    directions: Mapping[str, Positions] = field(default_factory=dict)
    correction: MotionCorrection | None = None
    mesh: TetMesh | None = None
    refinement: int = 1
    integrator: IntegratorName = "bdf2"
    doubt: float = 1.0
    reduced: bool = False
    stiffer: float = 0.0
    surrogate_stiffer: float = 0.0
    cost: Cost = field(default_factory=Cost)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters: base ones, then `effect.dose`."""
        return self.base + tuple(f"{e.label}.{d.name}" for e in self.effects for d in e.doses)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Slice of the values that holds the doses of each effect."""
        ends = np.cumsum([len(self.base), *(len(e.doses) for e in self.effects)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def parameters(self, values: Vector) -> tuple[Parameter, ...]:
        """The unknowns, starting at `values`."""
        doubted = float(np.sqrt(self.doubt))
        out = [default_parameter(name).at(float(value)) for name, value in zip(self.base, values, strict=False)]
        if RATIO in self.base and self.situation.clamped:  # bending does not determine ν
            index, (mean, sigma) = self.base.index(RATIO), BASE_FIT.held_poisson_ratio
            out[index] = replace(out[index], prior_mean=mean, prior_sigma=sigma / doubted)
        for effect, where in zip(self.effects, self.slices, strict=True):
            for dose, value, name in zip(effect.doses, values[where], self.names[where], strict=True):
                step = dose.step(self.situation)
                start = float(np.clip(value, dose.lower, dose.upper))
                sigma = dose.plausible / doubted if self.situation.clamped else np.inf
                out.append(_DoseParameter(name, start, dose.lower, dose.upper, step, dose.null, sigma))
        return tuple(out)

    def null_values(self) -> Vector:
        """The twin's base parameters, and the doses at which the effects are absent."""
        return np.concatenate([parameter_values(self.twin.scene, self.base), *(e.null for e in self.effects)])

    # -- scenes

    def _in_scene(self, scene: AnyScene, values: Vector) -> AnyScene:
        for effect, where in zip(self.effects, self.slices, strict=True):
            if effect.scene is not None:
                scene = effect.scene(scene, values[where])
        return scene

    def _based(self, values: Vector) -> Twin:
        if self.stiffer and MODULUS in self.base:
            values = values.copy()
            values[self.base.index(MODULUS)] += self.stiffer
        return self.twin.with_values(self.base, values[: len(self.base)])

    def full_scene(self, values: Vector) -> FullScene:
        """Full-order scene with the effects."""
        scene = self._in_scene(self._based(values).full_scene(self.mesh), values)
        assert isinstance(scene, FullScene)
        return scene

    def reduced_scene(self, values: Vector) -> ReducedScene:
        """Reduced scene with the effects."""
        scene = self._in_scene(self._based(values).scene, values)
        assert isinstance(scene, ReducedScene)
        return scene

    def lowest_frequency(self, values: Vector) -> float:
        """Lowest vibration frequency of the body on the model's mesh [Hz], attached masses included."""
        scene = self.full_scene(values)
        carried = None if scene.hanging is None else scene.hanging_masses
        if scene.held is None:
            return float(vibration_modes(scene.body, 7, carried=carried)[0][6])
        held = np.zeros(len(scene.body.mesh.vertices), dtype=bool)
        held[scene.held.nodes] = True
        return float(vibration_modes(scene.body, 1, clamped=held, carried=carried)[0][0])

    # -- motions

    @cached_property
    def embedding(self) -> Embedding:
        """The points in the full-order mesh."""
        return Embedding.of_points(self.twin.mesh if self.mesh is None else self.mesh, self.points)

    @property
    def _end(self) -> float:
        """Time of the last frame [s]."""
        return (self.frames - 1) / self.twin.fps

    def _ahead(self, values: Vector) -> float:
        """Time that the effects need beyond the last frame [s]."""
        looking = zip(self.effects, self.slices, strict=True)
        return max((e.ahead(self._end, values[where]) for e, where in looking if e.ahead is not None), default=0.0)

    def _timing(self, steps_per_frame: int, values: Vector) -> Timing:
        timing = accurate(replace(self.twin.timing(self.frames), steps_per_frame=steps_per_frame))
        return timing.every_step(self._ahead(values))

    def _motion(self, times: np.ndarray, positions: np.ndarray, velocities: np.ndarray, every: int) -> PointMotion:
        steps = PointMotion(self.points, times, positions, velocities, self.camera)
        return PointMotion.of_steps(steps, self.frames, every)

    def motion(self, values: Vector) -> PointMotion:
        """Motion of the points, before correction and observation."""
        return self.reduced_motion(values) if self.reduced else self.full_motion(values)[0]

    def full_motion(self, values: Vector) -> tuple[PointMotion, FullScene, Trajectory]:
        """The motion by the full-order model, the scene, and its states at all time steps.

        Raises:
            ConvergenceError: the body cannot be simulated there.
        """
        steps, scene = self.twin.steps_per_frame * self.refinement, self.full_scene(values)
        timing, nodes = replace(self._timing(steps, values), integrator=self.integrator), len(scene.body.mesh.vertices)
        try:
            run = simulate(scene, timing)
        except ConvergenceError:
            self.cost.add_failed(scene, nodes, timing.frames)
            raise
        self.cost.add(scene, nodes, run.statistics)
        positions, velocities = self.embedding.apply(run.positions), self.embedding.apply(run.velocities)
        return self._motion(run.times, positions, velocities, steps), scene, run

    def reduced_motion(self, values: Vector) -> PointMotion:
        """The motion by the reduced model."""
        timing, scene = self._timing(self.twin.steps_per_frame, values), self.reduced_scene(values)
        try:
            run = simulate(scene, timing)
        except ConvergenceError:
            self.cost.add_failed(scene, None, timing.frames)
            raise
        self.cost.add(scene, None, run.statistics)
        shapes = self.twin.scene.body.space.shape_values(self.points)
        positions, velocities = shapes @ run.coordinates, shapes @ run.velocities
        return self._motion(run.times, positions, velocities, self.twin.steps_per_frame)

    def observed(self, motion: PointMotion, values: Vector) -> Positions:
        """Observed positions of a motion: corrected, with observation effects and numerical directions.

        The first image of a camera defines the surface points that it follows. An error of the camera or the clock
        therefore moves them only after that image.
        """
        if self.correction is not None:
            motion = self.correction.of(motion)
        positions = motion.positions
        first = positions[0]
        for effect, where in zip(self.effects, self.slices, strict=True):
            if effect.observe is not None:
                moved = replace(motion, positions=positions, camera=self.camera)
                positions = effect.observe(moved, values[where])
                if self.camera is not None:
                    positions = _from_first_image(self.camera, positions, first)
            if effect.name in self.directions:
                positions = positions + float(values[where][0]) * self.directions[effect.name][: self.frames]
        return positions

    def positions(self, values: Vector) -> Positions:
        """Observed positions [m]."""
        return self.observed(self.motion(values), values)

    # -- differences

    def linearise(
        self, values: Vector, motion: PointMotion | None = None
    ) -> tuple[Positions, Float[np.ndarray, "T K P 3"]]:
        """Observed positions and their derivatives by all parameters, doses included, by finite differences.

        `motion` is the motion there, if it is known.
        """
        motion = self.motion(values) if motion is None else motion
        here, columns = self.observed(motion, values), []
        for index, parameter in enumerate(self.parameters(values)):
            step = _BASE_STEP * parameter.step
            if not parameter.lower <= values[index] + step <= parameter.upper:
                step = -step
            changed = values.copy()
            changed[index] += step
            moved = self._motion_at(changed, values, motion)
            columns.append((self.observed(moved, changed) - here) / step)
        return here, np.stack(columns, axis=1) if columns else np.zeros((len(here), 0, *here.shape[1:]))

    def secant(self, values: Vector, positions: Positions, tangents: Float[np.ndarray, "T K P 3"]) -> SecantModel:
        """The unknowns with derivatives updated from known ones; a fit ends when its runs have used their budget."""
        scales = np.array([p.step for p in self.parameters(values)])
        return SecantModel(self, values, positions, tangents, scales=scales, check=self.cost.check)

    def signature(self, changed: Vector, values: Vector, motion: PointMotion) -> Positions:
        """Change of the observed positions by a change of the doses [m], from `values` with their `motion`.

        Raises:
            ConvergenceError: the body with that dose cannot be simulated.
        """
        moved = self._motion_at(changed, values, motion)
        return self.observed(moved, changed) - self.observed(motion, values)

    def _motion_at(self, changed: Vector, values: Vector, motion: PointMotion) -> PointMotion:
        """The motion at changed values; the given one if only the observation changes."""
        own = len(self.base)
        moving = [slice(own), *(w for e, w in zip(self.effects, self.slices, strict=True) if e.scene is not None)]
        same = all(np.array_equal(changed[where], values[where]) for where in moving)
        known = self._end + self._ahead(changed) <= motion.end + 1e-9
        return motion if same and known else self.motion(changed)


def _from_first_image(camera: Camera, positions: Positions, first: Float[np.ndarray, "P 3"]) -> Positions:
    """Positions [m] shifted across the camera's view, equally in all images; the first one then shows `first` [m]."""
    local, start = camera.local(positions), camera.local(first)
    across = local[..., :2] / local[..., 2:]
    across = across - across[0] + start[:, :2] / start[:, 2:]
    return camera.world(np.concatenate([across * local[..., 2:], local[..., 2:]], axis=-1))


@dataclass(frozen=True)
class _DoseParameter(Parameter):
    """An unknown outside `physconvex.reduced.PARAMETERS`."""

    def __post_init__(self) -> None:
        assert self.lower <= self.start <= self.upper and self.step > 0


def reduced_like(full: EffectModel, motion: PointMotion, values: np.ndarray) -> tuple[EffectModel, PointMotion]:
    """A cheaper model, corrected by its difference to a full-order motion, and its own motion at the same values.

    The cheaper model is the reduced one; for a held body it is the full-order model on the twin's own, coarser mesh.
    The reduced model of a held body vibrates at another frequency, and an added motion corrects that only without
    damping. If the mesh of a held body is no larger than the coarse one, the model itself serves.
    """
    if searches_itself(full):
        reduced = replace(full, correction=None)
    else:
        reduced = replace(
            full, reduced=not full.situation.clamped, mesh=None, correction=None, stiffer=full.surrogate_stiffer
        )
    own = reduced.motion(values)
    exact = motion if full.correction is None else full.correction.of(motion)
    return replace(reduced, correction=MotionCorrection.between(exact, own)), own


def decades_between(one: EffectModel, other: EffectModel, values: np.ndarray) -> float:
    """Change of log10 E that gives another mesh the lowest frequency of this one."""
    return 2 * float(np.log10(one.lowest_frequency(values) / other.lowest_frequency(values)))


def searches_itself(full: EffectModel) -> bool:
    """Whether a held body has no cheaper model: a run on its mesh costs hardly more than on the coarse one."""
    mesh, coarse = full.mesh, full.twin.mesh
    if mesh is None or not full.situation.clamped:
        return False
    return len(mesh.vertices) <= BASE_FIT.searches_itself * len(coarse.vertices) and mesh.order <= coarse.order
