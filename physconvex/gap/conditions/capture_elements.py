"""The recording's own elements: linear tetrahedra on the capture's mesh become the model if they fit better.

A program that makes a recording often leaves its mesh in `tets.npz`. Its linear tetrahedra lock, and bend sideways if
all diagonals run one way. A model on other elements lacks this error, and the difference may hide or mimic an effect;
the same elements reproduce it. The fitted frames decide between the two before any effect is tried.

Some of these programs move particles (MuJoCo's flex): each node has the same mass, whatever its elements. The end of a
beam is then heavier than its volume, which mimics a hanging load. The masses are therefore tested as well.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.base_fit import fit_baseline, misfit_of_base
from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.base.model import MODULUS, RATIO, EffectModel, decades_between, searches_itself
from physconvex.gap.effects.catalogue import DEFAULT_EFFECTS, applicable
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import SETTING
from physconvex.mesh import TetMesh

_COMPANY = ("gravity_tilt", "damping")  # effects that are fitted together with the masses


def mesh_of_capture_elements(base: Baseline) -> TetMesh | None:
    """The capture's linear tetrahedra, if it has some and a run is affordable."""
    mesh = base.capture.tets()
    steps = base.model.frames * base.model.twin.steps_per_frame
    linear = mesh is not None and mesh.order == 1 and len(mesh.vertices) * steps <= SETTING.own_work
    return mesh if linear and MODULUS in base.model.base else None


def with_own_elements(
    base: Baseline,
    rough: Baseline,
    numerics: Numerics,
    variance: Float[np.ndarray, " N"],
    *,
    options: GapOptions,
    report: Report,
    known: bool | None = None,
) -> tuple[Baseline, Numerics]:
    """The base fit on the capture's own linear elements if they are the recording's; otherwise the unchanged base fit.

    Args:
        base: the base fit on elements of the diagnosis.
        rough: start of the fits.
        numerics: differences of runs; for a held body on its own elements, the mesh error is zero.
        variance: variance of the residuals of a free body, all frames; those of a held one weigh equally.
        options, report: settings, and what receives progress messages.
        known: whether they are the recording's, if `physconvex.gap.conditions.setting` has tested that; by default they
            are if they halve the squares.
    """
    mesh = mesh_of_capture_elements(base)
    if mesh is None or not base.tangents.any() or known is False:
        return base, numerics
    if base.situation.clamped:  # the error of the other mesh, which widens the variance, is under test
        variance = np.ones_like(variance)
    before = misfit_of_base(base, variance)

    def fitted(mesh: TetMesh, near: Baseline, most: float) -> Baseline | None:
        """The base fit on other elements; None if it cannot be run, or E alone leaves more than `most`."""
        try:
            found = _start_on(mesh, near, rough, variance, most)
            if found is None:
                return None
            start, motion = found
            correction = MotionCorrection(numerics.steps)
            return fit_baseline(start, correction, (mesh, motion), variance, options=options, report=report)
        except (ConvergenceError, InputError):
            return None

    report("base model on the capture's own elements")
    own = fitted(mesh, base, np.inf if known else SETTING.hopeless * before)
    if own is None:
        return base, numerics
    report("base model with equal masses at the capture's own nodes")
    particles = fitted(mesh.with_equal_masses(), own, SETTING.hopeless * misfit_of_base(own, variance))
    if particles is not None and _left_beside(particles, variance) < SETTING.equal_masses * _left_beside(own, variance):
        own = particles
    if not known and misfit_of_base(own, variance) > SETTING.own_better * before:
        return base, numerics
    numerics = replace(numerics, exact=None)  # it belongs to other elements
    still = np.zeros_like(numerics.mesh)
    return own, replace(numerics, mesh=still) if base.situation.clamped else numerics


def _left_beside(base: Baseline, variance: Float[np.ndarray, " N"]) -> float:
    """Mean square in the fitted frames after a fit of E, ν and, to first order, some effects.

    A tilt of gravity has a larger share of the squares and would otherwise hide the masses.
    """
    rows, values = base.rows(base.split.fitted), np.asarray(base.fit.values)
    steps = [0.1 * p.step for p in base.model.parameters(values)]
    moved = [step * tangent for step, tangent in zip(steps, np.moveaxis(base.tangents, 1, 0), strict=True)]
    for effect in applicable(DEFAULT_EFFECTS, base.situation):
        if effect.label not in _COMPANY:
            continue
        model, nothing = replace(base.model, effects=(effect,)), np.concatenate([values, effect.null])
        for at, dose in enumerate(effect.doses, len(values)):
            tried = nothing.copy()
            tried[at] += dose.trial(base.situation)
            with suppress(ConvergenceError):
                moved.append(model.signature(tried, nothing, base.motion))
    deviations = np.sqrt(variance[rows])
    columns = np.stack([base.change(base.positions[: len(m)] + m)[rows] / deviations for m in moved], axis=1)
    residual = base.residual(base.positions)[rows] / deviations
    columns /= np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    return float(np.mean((residual - columns @ np.linalg.lstsq(columns, residual)[0]) ** 2))


def _start_on(
    mesh: TetMesh, near: Baseline, rough: Baseline, variance: Float[np.ndarray, " N"], most: float
) -> tuple[Baseline, PointMotion] | None:
    """Start of a fit on other elements at an E of equal vibration, and the motion there.

    None if E alone leaves more than `most`.
    """
    index, model = near.model.base.index(MODULUS), replace(near.model, mesh=mesh)
    model.embedding  # noqa: B018 markers may lie off that mesh
    values = near.fit.values.copy()
    if RATIO in near.model.base and near.model.mesh is None:
        at = near.model.base.index(RATIO)
        values[at] = np.clip(values[at], *SETTING.own_poisson_ratio)
    values[index] += decades_between(near.model, model, values)
    least, values[index] = _best_modulus(near, model, values, variance)
    if least > most:
        return None
    motion = model.motion(values)
    another = near.situation.clamped and not searches_itself(model)  # a coarser mesh then searches instead
    stiffer = _surrogate(near, mesh, values, motion.positions) if another else 0.0
    model = replace(rough.model, surrogate_stiffer=stiffer)
    return replace(rough, fit=replace(rough.fit, values=values), model=model), motion


def _best_modulus(
    base: Baseline, model: EffectModel, start: np.ndarray, variance: Float[np.ndarray, " N"]
) -> tuple[float, float]:
    """Least misfit in the fitted frames over log10 E near the start, and that log10 E."""
    index, count = base.model.base.index(MODULUS), base.split.end
    shorter, tried = replace(model, frames=count), []
    for decades in SETTING.own_moduli:
        values = start.copy()
        values[index] += decades
        positions = np.concatenate([shorter.positions(values), base.positions[count:]])
        tried.append((misfit_of_base(base, variance, positions), values[index]))
    return min(tried)


def _surrogate(base: Baseline, mesh: TetMesh, values: np.ndarray, target: Float[np.ndarray, "T P 3"]) -> float:
    """Change of log10 E that gives the cheaper model the vibration of the own elements."""
    count = base.split.end
    coarse = replace(base.model, mesh=None, correction=None, frames=count)

    def missed(decades: float) -> float:
        moved = replace(coarse, stiffer=decades).motion(values).positions
        return float(np.linalg.norm(moved - target[:count]))

    first = decades_between(replace(base.model, mesh=mesh), coarse, values)
    return first + min(SETTING.surrogate_moduli, key=lambda more: missed(first + more))
