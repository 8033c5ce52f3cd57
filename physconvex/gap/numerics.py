"""How far the model can be trusted: differences between its own runs with other steps, meshes and contact.

None of these runs holds an effect. What they differ by is what any effect-free capture may differ by from the model
(simulated by another program, or real), so they serve as the null of the scores and as the floor of the gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.fem import TetMesh, refine, simulate, tetrahedralize
from physconvex.gap.baseline import Baseline, Report, derivatives_of_residuals
from physconvex.gap.boxes import box_of_body
from physconvex.gap.effects import Motion
from physconvex.gap.model import ACCURACY
from physconvex.gap.options import GapOptions
from physconvex.gap.score import ErrorModel
from physconvex.identify import mesh_of_capture

__all__ = ["Numerics", "correction_of", "detail_errors", "error_model", "numerical_differences", "other_mesh"]

Positions = Float[np.ndarray, "T P 3"]
_WORK = 600_000  # nodes times steps of a full-order run that is made some twenty times
_ORDER = 1.75  # of convergence by edge length
_STEPS_LEFT = 0.5  # error of half the time step over the difference to the whole one
_LASTING = 2.0  # frames for which a numerical error stays much the same


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
        absorbed_mesh: `mesh` after E and ν have been fitted, see `physconvex.gap.absorbing`; None where they were not.
    """

    steps: Positions
    mesh: Positions
    contact: Positions
    implicit_euler: Positions
    reduction: Positions
    fine: tuple[TetMesh, Motion] | None = None
    nodes: tuple[int, int] = (1, 1)
    failed: tuple[str, ...] = ()
    absorbed_mesh: Positions | None = None

    @property
    def null(self) -> tuple[Positions, ...]:
        """Differences that effect-free captures may show."""
        mesh = self.mesh if self.absorbed_mesh is None else self.absorbed_mesh
        return (_STEPS_LEFT * self.steps, self._mesh_left * mesh, self.contact)

    @property
    def _mesh_left(self) -> float:
        """Error of the finer mesh over the difference of the two (Richardson; contact lowers the order below two)."""
        ratio = max(self.nodes[1] / self.nodes[0], 1.01)
        return float(np.clip(1 / (ratio ** (_ORDER / 3) - 1), 0.3, 1.0))


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
        run = simulate(scene, **model.twin.timing(model.frames), **ACCURACY)
        return np.asarray(model.embedding.apply(run.positions))

    fine: list[tuple[TetMesh, Motion]] = []
    steps = model.frames * model.twin.steps_per_frame

    def finer() -> Positions:
        mesh = other_mesh(base, options, steps)
        fine.append((mesh, replace(model, mesh=mesh).motion(values)))
        return np.asarray(fine[0][1].positions)

    zero = np.zeros_like(here)
    # where the floor gives way its stiffness is fitted: a property of the recording's floor, and no error of the model
    stiffness_is_chosen = base.situation.touches and not base.situation.giving_floor
    mesh = difference("a finer mesh", finer)
    return Numerics(
        steps=difference("half the time step", lambda: replace(model, refinement=2).motion(values).positions),
        mesh=mesh,
        fine=fine[0] if fine and len(fine[0][0].vertices) * steps <= _WORK else None,
        nodes=(len(model.twin.mesh.vertices), len(fine[0][0].vertices) if fine else len(model.twin.mesh.vertices)),
        contact=difference("stiffer contact", stiffer) if stiffness_is_chosen else zero,
        implicit_euler=difference(
            "implicit Euler", lambda: replace(model, integrator="implicit_euler").motion(values).positions
        ),
        reduction=difference("the reduced model", lambda: model.reduced_motion(values).positions),
        failed=tuple(failed),
    )


def other_mesh(base: Baseline, options: GapOptions, steps: int) -> TetMesh:
    """A finer mesh, as far as a run of so many steps is affordable: of a held body every element split, else anew.

    A held body is split since another mesh would be held in other places, which moves it more than its resolution does.
    """
    own = base.model.twin.mesh
    if base.situation.clamped:
        split = refine(own)
        if len(split.vertices) * steps > 3 * _WORK:
            raise InputError(f"mesh: {len(split.vertices)} nodes are too many for {steps} steps")
        return split
    wanted = max(min(options.fine_nodes, _WORK // steps), int(2.5 * len(own.vertices)))
    box = box_of_body(base.capture, wanted)
    mesh = mesh_of_capture(base.capture, max_nodes=wanted) if box is None else box
    if len(mesh.vertices) > 1.3 * len(own.vertices):
        return mesh
    return tetrahedralize(own.surface, max_nodes=wanted, order=2, method="auto")


def correction_of(numerics: Numerics) -> Positions:
    """What finer steps change, and a finer mesh if that cannot be afforded: added to every run of the model."""
    return numerics.steps if numerics.fine is not None else numerics.steps + numerics.mesh


def error_model(
    base: Baseline, numerics: Numerics, options: GapOptions, *, scale: float | Float[np.ndarray, " T"] = 1.0
) -> ErrorModel:
    """V of `physconvex.gap.score`: noise, the size of numerical differences in each frame, and their shapes.

    Where the base model is fitted (its tangents are known), the size is that of what the differences leave once E, ν
    and the free initial motion have absorbed what they can of them, as they do of the recording's own.

    Args:
        base: the base fit.
        numerics: the differences.
        options: settings.
        scale: factor on the differences, one or one per frame, see `physconvex.gap.trust`.
    """
    here, frames = base.positions, base.observations.frames
    scales = options.error_scale * np.broadcast_to(scale, base.model.frames)
    directions = scales[frames] * np.stack([base.change(here + d) for d in numerics.null])
    count = np.maximum(np.bincount(frames, minlength=base.model.frames), 1)
    travelled = np.linalg.norm(base.motion.positions - base.motion.rest, axis=-1).mean(1)
    floor = base.change(here + (options.discretisation * travelled)[:, None, None] / np.sqrt(3)) ** 2

    def size_of(left: np.ndarray) -> np.ndarray:
        total = np.bincount(frames, (left**2).sum(0), minlength=base.model.frames)
        size = np.maximum.accumulate(total / count)  # an error made at impact stays
        return np.asarray(size[frames] + floor)

    numerical = size_of(directions)
    if len(base.tangents) == base.model.frames and base.tangents.any():
        numerical = size_of(_absorbed(base, directions, 1.0 + numerical))
    return ErrorModel(1.0 + _correlated(count)[frames] * numerical, directions, 1.0 + numerical)


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


def _correlated(count: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """How much less the residuals of a frame tell than so many independent ones.

    Numerical errors are smooth fields that last: as good as affine in space (twelve numbers) and the same for some
    frames, so that n residuals hold about 12/_LASTING independent ones. Widening their variance by the ratio leaves a
    smooth signature with the significance it deserves.
    """
    return np.maximum(_LASTING * count / 12.0, 1.0)
