"""How far the model can be trusted: differences between its own runs with other steps, meshes and contact.

None of these runs holds an effect. What they differ by is what any effect-free capture may differ by from the model
(simulated by another program, or real), so they serve as the null of the scores and as the floor of the gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import simulate
from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline, Report, derivatives_of_residuals
from physconvex.gap.base.box_mesh import box_of_body
from physconvex.gap.base.model import EffectModel, accurate
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.errors.rebound import path_since_contact
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import NUMERICAL_ERROR
from physconvex.identify import mesh_of_capture
from physconvex.mesh import TetMesh, refine_uniformly, tetrahedralize
from physconvex.numerics import beyond_rigid

__all__ = [
    "Numerics",
    "correction_of",
    "detail_errors",
    "error_model",
    "exact_model",
    "numerical_differences",
    "other_mesh",
]

Positions = Float[np.ndarray, "T P 3"]


@dataclass(frozen=True, eq=False)
class Numerics:
    """Differences of effect-free runs to the rough base run, at the observed points.

    Attributes:
        steps: with half the time step, [T, P, 3] m.
        mesh: with a finer mesh, which takes the place of the model's from the base fit on.
        contact: with a contact twice as stiff; zero where nothing touches, or where its stiffness is fitted.
        implicit_euler: first-order steps instead of second-order ones.
        reduction: the reduced model.
        fine: the finer mesh, and the motion on it; None where it could not be run, or not often.
        nodes: of the model's mesh and of the finer one.
        failed: names of runs that did not converge (their differences are zero).
        absorbed_mesh: `mesh` after E and ν were fitted (`absorbed_errors`); None where they were not.
        finest: of a free body, with a mesh finer still, to the run on the finer one; None where it was not run.
        exact: that mesh, and the same with a quarter of the time step as well.
    """

    steps: Positions
    mesh: Positions
    contact: Positions
    implicit_euler: Positions
    reduction: Positions
    fine: tuple[TetMesh, PointMotion] | None = None
    nodes: tuple[int, int] = (1, 1)
    failed: tuple[str, ...] = ()
    absorbed_mesh: Positions | None = None
    finest: Positions | None = None
    exact: tuple[TetMesh, Positions] | None = None

    @property
    def null(self) -> tuple[Positions, ...]:
        """Differences that effect-free captures may show."""
        if self.exact is None or self.finest is None:
            return (NUMERICAL_ERROR.steps_left * self.steps, self._mesh_left, self.contact)
        steps = NUMERICAL_ERROR.exact_left * (self.exact[1] - self.finest)
        return (steps, self._mesh_left / NUMERICAL_ERROR.fine_over_finest, self.contact)

    @property
    def _mesh_left(self) -> Positions:
        """Error of the finer mesh, from differences of two (Richardson; contact lowers the order below two).

        After an impact one mesh may happen to fly on otherwise than all others, and so be off by ten times what the
        finer one errs by. So that is compared with a coarser and with a finer one, and the lesser estimate is believed.
        """
        ratio = max(self.nodes[1] / self.nodes[0], 1.01) ** (NUMERICAL_ERROR.order / 3)
        left = float(np.clip(1 / (ratio - 1), 0.3, 1.0))
        by_coarser = np.asarray(left * (self.mesh if self.absorbed_mesh is None else self.absorbed_mesh))
        if self.finest is None:
            return by_coarser
        by_finer = np.asarray(NUMERICAL_ERROR.fine_over_finest / (NUMERICAL_ERROR.fine_over_finest - 1) * self.finest)
        return min(by_coarser, by_finer, key=lambda d: float(np.linalg.norm(d)))


def numerical_differences(base: Baseline, options: GapOptions, report: Report) -> Numerics:
    """Run the base model again in other ways."""
    here, values, model = base.motion.positions, base.fit.values, base.model
    failed: list[str] = []

    def difference(name: str, run: Callable[[], Positions]) -> Positions:
        report(f"numerical error: {name}")
        try:
            return np.asarray(run() - here)
        except (ConvergenceError, InputError):
            failed.append(name)
            return np.zeros_like(here)

    def stiffer() -> Positions:
        scene = model.full_scene(values)
        scene = replace(scene, contact_stiffness=2 * scene.contact().stiffness)
        run = simulate(scene, accurate(model.twin.timing(model.frames)))
        return np.asarray(model.embedding.apply(run.positions))

    fine: list[tuple[TetMesh, PointMotion]] = []
    steps = model.frames * model.twin.steps_per_frame

    def finer() -> Positions:
        mesh = other_mesh(base, options, steps)
        fine.append((mesh, replace(model, mesh=mesh).motion(values)))
        return np.asarray(fine[0][1].positions)

    finest_mesh: list[TetMesh] = []

    def finest() -> Positions:
        nodes = NUMERICAL_ERROR.finest * len(fine[0][0].vertices)
        if nodes * steps > 2 * NUMERICAL_ERROR.finest * NUMERICAL_ERROR.fine_work:
            raise InputError(f"mesh: {nodes:.0f} nodes are too many for {steps} steps")
        finest_mesh.append(_mesh_of(base, int(nodes)))
        return beyond_fine(replace(model, mesh=finest_mesh[0]))

    def beyond_fine(better: EffectModel) -> Positions:
        return np.asarray(better.motion(values).positions - fine[0][1].positions + here)

    zero = np.zeros_like(here)
    # where the floor gives way its stiffness is fitted: a property of the recording's floor, and no error of the model
    stiffness_is_chosen = base.situation.touches and not base.situation.giving_floor
    mesh = difference("a finer mesh", finer)
    compared = base.situation.touches and not base.situation.clamped and bool(fine)
    last = difference("a mesh finer still", finest) if compared else zero
    quick = last.any() and len(finest_mesh[0].vertices) * steps <= NUMERICAL_ERROR.exact_work
    linear = model.mesh is not None and model.mesh.order == 1  # the recording's own elements, whose errors it shares
    exact = zero
    if quick and not linear:
        exact = difference(
            "a mesh finer still, a quarter of the time step", lambda: beyond_fine(exact_model(model, finest_mesh[0]))
        )
    return Numerics(
        steps=difference("half the time step", lambda: replace(model, refinement=2).motion(values).positions),
        mesh=mesh,
        fine=fine[0] if fine and len(fine[0][0].vertices) * steps <= NUMERICAL_ERROR.fine_work else None,
        nodes=(len(model.twin.mesh.vertices), len(fine[0][0].vertices) if fine else len(model.twin.mesh.vertices)),
        contact=difference("stiffer contact", stiffer) if stiffness_is_chosen else zero,
        implicit_euler=difference(
            "implicit Euler", lambda: replace(model, integrator="implicit_euler").motion(values).positions
        ),
        reduction=difference("the reduced model", lambda: model.reduced_motion(values).positions),
        failed=tuple(failed),
        finest=last if last.any() else None,
        exact=(finest_mesh[0], exact) if exact.any() else None,
    )


def exact_model(model: EffectModel, mesh: TetMesh) -> EffectModel:
    """The model on a mesh finer still and with a quarter of its time step."""
    return replace(model, mesh=mesh, refinement=NUMERICAL_ERROR.exact_refinement, correction=None)


def other_mesh(base: Baseline, options: GapOptions, steps: int) -> TetMesh:
    """A finer mesh, as far as a run of so many steps is affordable: of a held body every element split, else anew.

    A held body is split since another mesh would be held in other places, which moves it more than its resolution does.
    """
    own = base.model.twin.mesh
    if base.situation.clamped:
        split = refine_uniformly(own)
        if len(split.vertices) * steps > 3 * NUMERICAL_ERROR.fine_work:
            raise InputError(f"mesh: {len(split.vertices)} nodes are too many for {steps} steps")
        return split
    wanted = max(min(options.fine_nodes, NUMERICAL_ERROR.fine_work // steps), int(2.5 * len(own.vertices)))
    mesh = _mesh_of(base, wanted)
    if len(mesh.vertices) > 1.3 * len(own.vertices):
        return mesh
    return tetrahedralize(own.surface, max_nodes=wanted, order=2, method="auto")


def _mesh_of(base: Baseline, nodes: int) -> TetMesh:
    """A mesh of the body of so many nodes."""
    box = box_of_body(base.capture, nodes)
    return mesh_of_capture(base.capture, max_nodes=nodes) if box is None else box


def correction_of(numerics: Numerics) -> MotionCorrection:
    """What finer steps change, and a finer mesh if that cannot be afforded: added to every run of the model."""
    best = numerics.steps if numerics.exact is None else numerics.exact[1]
    return MotionCorrection(best if numerics.fine is not None else best + numerics.mesh)


def error_model(
    base: Baseline, numerics: Numerics, options: GapOptions, *, scale: float | Float[np.ndarray, " N"] = 1.0
) -> ErrorModel:
    """V of `physconvex.gap.errors.score_test`: noise, and by frame and kind size and shapes of numerical differences.

    Such errors are smooth fields that last: few numbers (`BodyModes.freedom`), and the same ones for some frames, so
    that n residuals hold no more than about freedom/`lasting` independent ones. Widening their variance by the ratio
    leaves a smooth signature with the significance it deserves.

    Any model of finite size is credited with a share of the distance travelled, and of a free body with what programs
    that share neither mesh nor steps nor contact fall out of phase by once it has been struck: shares `out_of_step` of
    how far it has come since, of its largest even strain, and of its largest finer shape, so far. Across the normal of
    the floor it is less: that pushes there by friction alone.

    Where the base model is fitted (its tangents are known), the size is that of what the differences leave once E, ν
    and the free initial motion have absorbed what they can of them, as they do of the recording's own.

    Args:
        base: the base fit.
        numerics: the differences.
        options: settings.
        scale: factor on the differences, one or one per residual, see `physconvex.gap.errors.error_scale`.
    """
    here, frames = base.positions, base.observations.frames
    directions = options.error_scale * scale * np.stack([base.change(here + d) for d in numerics.null])
    kinds, shape = base.modes.kinds, (base.modes.count, base.model.frames)
    place = kinds * base.model.frames + frames
    count = np.maximum(np.bincount(place, minlength=shape[0] * shape[1]), 1).reshape(shape)

    def mean_of(squares: np.ndarray) -> np.ndarray:
        return np.bincount(place, squares, minlength=count.size).reshape(shape) / count

    travelled = np.linalg.norm(base.motion.positions - base.motion.rest, axis=-1).mean(1)
    floor = mean_of(base.change(here + (options.discretisation * travelled)[:, None, None] / np.sqrt(3)) ** 2)
    phases = np.zeros(shape)
    if base.modes.reflections:
        path = path_since_contact(base.motion, base.contact_force)
        come = mean_of(base.change(here + path[:, None, None] / np.sqrt(3)) ** 2)
        whole = base.modes.struck & (base.modes.parts == 0)  # along and across alike, before the share
        come[whole] = (come * count)[whole].sum(0) / count[whole].sum(0)
        strained = mean_of(base.change(here + beyond_rigid(base.motion.rest, base.motion.positions)[0]) ** 2)
        so_far = np.maximum.accumulate(np.where(base.modes.parts[:, None] == 0, come, strained), axis=1)
        sideways = np.where(base.modes.across, min(NUMERICAL_ERROR.sideways + base.situation.friction, 1.0), 1.0)
        phases = (np.array(NUMERICAL_ERROR.out_of_step)[base.modes.parts] * sideways)[:, None] ** 2 * so_far

    def size_of(left: np.ndarray) -> np.ndarray:
        size = np.maximum.accumulate(mean_of((left**2).sum(0)), axis=1)  # an error made at impact stays
        return np.asarray((size + floor)[kinds, frames] + np.square(scale) * phases[kinds, frames])

    numerical = size_of(directions)
    if len(base.tangents) == base.model.frames and base.tangents.any():
        numerical = size_of(_absorbed(base, directions, 1.0 + numerical))
    shared = np.maximum(NUMERICAL_ERROR.lasting * count / np.array(base.modes.freedom)[:, None], 1.0)
    return ErrorModel(1.0 + shared[kinds, frames] * numerical, directions, 1.0 + numerical)


def detail_errors(base: Baseline, errors: ErrorModel, share: float) -> ErrorModel:
    """Errors widened by a share of a held body's gap: what is smaller does not choose between effects.

    Else the frames that noise and numerical error leave most certain, the first ones of a held body, decide alone,
    although no model of a recording is as good as its numerical error: a release that lasts, or a load that hangs
    loosely, would be explained by whatever bends those few frames.
    """
    if not base.situation.clamped:
        return errors
    rows = base.rows(base.split.fitted)
    gap = np.maximum(base.residual(base.positions)[rows] ** 2 - errors.expected[rows], 0.0)
    width = share**2 * float(gap.mean())
    return ErrorModel(errors.variance + width, errors.directions, errors.expected + width)


def _absorbed(base: Baseline, directions: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """What is left of differences, all frames, once the base parameters have been fitted to them on the fitted ones."""
    here = base.positions
    tangents = derivatives_of_residuals(base, here, base.tangents)
    rows = base.rows(base.split.fitted)
    weights = 1 / np.sqrt(variance[rows])
    found = np.linalg.lstsq((tangents[:, rows] * weights).T, (directions[:, rows] * weights).T, rcond=1e-8)[0]
    return np.asarray(directions - found.T @ tangents)
