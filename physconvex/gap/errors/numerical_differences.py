"""Accuracy of the model: differences between its runs with other steps, meshes and contact.

No run has an effect, so any effect-free capture (from another program, or real) may differ from the model by as much.
The differences are the null of the scores and the floor of the gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import simulate
from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.base.box_mesh import box_of_body
from physconvex.gap.base.model import MODULUS, EffectModel, accurate
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import NUMERICAL_ERROR
from physconvex.identify import FitOptions, MarkerObservations, fit, mesh_of_capture
from physconvex.mesh import TetMesh, refine_uniformly, tetrahedralize

Positions = Float[np.ndarray, "T P 3"]


@dataclass(frozen=True, eq=False)
class Numerics:
    """Differences of effect-free runs to the rough base run, at the observed points.

    Attributes:
        steps: with half the time step [m], shape [T, P, 3].
        mesh: with a finer mesh, which replaces the model's from the base fit on.
        contact: with a contact twice as stiff; zero without contact, or if the contact stiffness is fitted.
        implicit_euler: first-order steps instead of second-order ones.
        reduction: the reduced model.
        fine: the finer mesh, and the motion on it; None if it cannot be run, or not often.
        nodes: number of nodes of the model's mesh and of the finer one.
        failed: names of runs that do not converge (their differences are zero).
        absorbed_mesh: `mesh` after a fit of E and ν (`absorbed_errors`); None without such a fit.
        finest: for a free body, difference of the finest mesh to the finer one; None if it is not run.
        exact: the finest mesh, and the change by it with a quarter of the time step as well.
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
    def directions(self) -> dict[str, Positions]:
        """Motions of the numerical effects, by name."""
        return {"time_step": self.implicit_euler, "mesh_resolution": self.mesh, "reduction": self.reduction}

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

        After an impact one mesh may by chance fly differently from all others, by ten times the error of the finer one.
        The finer mesh is therefore compared with a coarser and with a finest one, and the smaller estimate counts.
        """
        ratio = max(self.nodes[1] / self.nodes[0], 1.01) ** (NUMERICAL_ERROR.order / 3)
        left = float(np.clip(1 / (ratio - 1), 0.3, 1.0))
        by_coarser = np.asarray(left * (self.mesh if self.absorbed_mesh is None else self.absorbed_mesh))
        if self.finest is None:
            return by_coarser
        by_finer = np.asarray(NUMERICAL_ERROR.fine_over_finest / (NUMERICAL_ERROR.fine_over_finest - 1) * self.finest)
        return min(by_coarser, by_finer, key=lambda d: float(np.linalg.norm(d)))


def numerical_differences(base: Baseline, options: GapOptions, report: Report) -> Numerics:
    """Run the base model again with other numerical settings."""
    here, values, model = base.motion.positions, base.fit.values, base.model
    failed: list[str] = []

    def difference(name: str, run: Callable[[], Positions]) -> Positions:
        report(f"numerical error: {name}")
        try:
            return np.asarray(run() - here)
        except (ConvergenceError, InputError):
            failed.append(name)
            return np.zeros_like(here)

    def changed(**change: Any) -> Positions:
        return replace(model, **change).motion(values).positions

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
        return fine[0][1].positions

    finest_mesh: list[TetMesh] = []

    def finest() -> Positions:
        nodes = NUMERICAL_ERROR.finest * len(fine[0][0].vertices)
        if nodes * steps > 2 * NUMERICAL_ERROR.finest * NUMERICAL_ERROR.fine_work:
            raise InputError(f"mesh: {nodes:.0f} nodes are too many for {steps} steps")
        finest_mesh.append(_mesh_of(base, int(nodes)))
        return changed(mesh=finest_mesh[0]) - fine[0][1].positions + here

    def most_exact() -> Positions:
        return exact_model(model, finest_mesh[0]).motion(values).positions - fine[0][1].positions + here

    zero = np.zeros_like(here)
    # the fitted stiffness of a compliant floor is a property of the recording, not an error of the model
    stiffness_is_chosen = base.situation.touches and not base.situation.giving_floor
    mesh = difference("a finer mesh", finer)
    compared = base.situation.touches and not base.situation.clamped and bool(fine)
    last = difference("a mesh finer still", finest) if compared else zero
    quick = last.any() and len(finest_mesh[0].vertices) * steps <= NUMERICAL_ERROR.exact_work
    linear = model.mesh is not None and model.mesh.order == 1  # the recording's own elements share its errors
    exact = zero
    if quick and not linear:
        exact = difference("a mesh finer still, a quarter of the time step", most_exact)
    return Numerics(
        steps=difference("half the time step", lambda: changed(refinement=2)),
        mesh=mesh,
        fine=fine[0] if fine and len(fine[0][0].vertices) * steps <= NUMERICAL_ERROR.fine_work else None,
        nodes=(len(model.twin.mesh.vertices), len(fine[0][0].vertices) if fine else len(model.twin.mesh.vertices)),
        contact=difference("stiffer contact", stiffer) if stiffness_is_chosen else zero,
        implicit_euler=difference("implicit Euler", lambda: changed(integrator="implicit_euler")),
        reduction=difference("the reduced model", lambda: model.reduced_motion(values).positions),
        failed=tuple(failed),
        finest=last if last.any() else None,
        exact=(finest_mesh[0], exact) if exact.any() else None,
    )


def exact_model(model: EffectModel, mesh: TetMesh) -> EffectModel:
    """The model on the finest mesh and with a quarter of its time step."""
    return replace(model, mesh=mesh, refinement=NUMERICAL_ERROR.exact_refinement, correction=None)


def other_mesh(base: Baseline, options: GapOptions, steps: int) -> TetMesh:
    """A finer mesh within the affordable cost: every element split for a held body, a new mesh otherwise.

    A new mesh of a held body would be held at other places, which changes its motion more than its resolution does.
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
    """A mesh of the body with this many nodes."""
    box = box_of_body(base.capture, nodes)
    return mesh_of_capture(base.capture, max_nodes=nodes) if box is None else box


def correction_of(numerics: Numerics) -> MotionCorrection:
    """Correction of every run: change by finer steps, and by a finer mesh if runs on that are too expensive."""
    best = numerics.steps if numerics.exact is None else numerics.exact[1]
    return MotionCorrection(best if numerics.fine is not None else best + numerics.mesh)


def with_absorbed_mesh(base: Baseline, numerics: Numerics, options: GapOptions) -> Numerics:
    """The differences with that of the meshes taken between their fits; unchanged for a free body.

    `base` is the base fit on the finer mesh, and `numerics` has differences at one set of values.
    """
    if not base.situation.clamped or numerics.fine is None or MODULUS not in base.model.base:
        return numerics
    count = base.split.end
    coarse, target = replace(base.model, mesh=None, correction=None), base.motion.positions
    shorter, values = replace(coarse, frames=count), base.fit.values
    sigma = np.full(target.shape[:2], NUMERICAL_ERROR.absorbed * base.situation.size)
    seen = MarkerObservations(np.asarray(base.model.points), target, sigma).in_frames(count)
    try:
        here = shorter.motion(values)
        secant = shorter.secant(values, here.positions, shorter.linearise(values, here)[1])
        stop = FitOptions(max_iterations=options.iterations, relative_tolerance=1e-2, absolute_tolerance=0.1)
        found = fit(secant, seen, shorter.parameters(values), options=stop)
        left = coarse.motion(found.values).positions - target
    except ConvergenceError:
        return numerics
    if np.linalg.norm(left) > np.linalg.norm(numerics.mesh):
        return numerics
    return replace(numerics, absorbed_mesh=left)
