"""What noise and numerical error lead one to expect of each residual, and how much of that is really there.

**Its scale** (`error_scale`). What a mesh of 250 nodes and one of 1000 differ by after an impact may be many times
what the finer one errs by, and a smaller effect is then lost in it. The residual of the fitted frames is error and
effect together: if the base model, or it with one effect, leaves a tenth of the expected error, the error is no
larger than that tenth (unless the two cancel all the time). As in a regression, the scale of the errors comes from
the largest model. A margin keeps what an effect absorbs of numerical error by chance from being called a cause, and
what unknowns absorb of few independent residuals is made up for by their leverage, as degrees of freedom are in a
regression. After the fitted frames differences between meshes grow on; of these frames no more is believed than what
the base model leaves there, with the same margin. Each kind of residual (`physconvex.gap.base.body_modes`) has a
scale of its own: a rebound that is off says nothing of strains.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.gap.base.baseline import Baseline, derivatives_of_residuals
from physconvex.gap.base.body_modes import BodyModes
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screening
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import NUMERICAL_ERROR
from physconvex.numerics import beyond_rigid


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
        scale: factor on the differences, one or one per residual, see `error_scale`.
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


def path_since_contact(motion: PointMotion, force: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Length of the mean point's way from the last frame before the first contact to each frame [m]; 0 before.

    A model whose impact throws a body off by a hundredth too much is off by a hundredth of it from then on. (The
    distance from where the body would have fallen to says so too, but grows on for one that lies.)

    Args:
        motion: of points of the body.
        force: of contact in each frame [N].
    """
    touched = np.flatnonzero(force > 0)
    if not len(touched):
        return np.zeros(len(force))
    last = max(int(touched[0]) - 1, 0)  # of the fall
    steps = np.linalg.norm(np.diff(motion.positions.mean(1), axis=0), axis=1)
    steps[:last] = 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])


def forgiving(errors: ErrorModel, modes: BodyModes) -> ErrorModel:
    """Errors with which a body as a whole may be off by three times as much from the first contact on.

    Without any effect, what two programs part by as a whole after an impact came to .3 to 3 % of the way; a hundredth
    is what the evidence counts with.
    """
    whole = modes.struck & (modes.parts == 0)
    factor = np.where(whole[modes.kinds], NUMERICAL_ERROR.forgiven_rebound**2, 1.0)
    return ErrorModel(1 + factor * (errors.variance - 1), errors.directions, 1 + factor * (errors.expected - 1))


def error_scale(base: Baseline, errors: ErrorModel, screening: Screening) -> Float[np.ndarray, " N"]:
    """Factor on the numerical error of each residual, 0.15 to 1.

    Args:
        base: the base fit.
        errors: with the numerical error as other meshes, steps and contact have it.
        screening: of the effects at that fit; each may explain what it can to first order, numerical ones not.
    """
    last, kinds = int(base.split.fitted[-1]), base.modes.kinds
    fitted = _fitted_scale(base, errors, screening)
    rows = base.rows(base.split.selecting)
    unfitted = (base.residual(base.positions)[rows], np.zeros(len(rows)))
    late = np.minimum(fitted, _scale(base, errors, rows, [unfitted]))
    return np.where(base.observations.frames > last, late[kinds], fitted[kinds])


def _fitted_scale(base: Baseline, errors: ErrorModel, screening: Screening) -> Float[np.ndarray, " K"]:
    """By kind, of the fitted frames."""
    rows = base.rows(base.split.fitted)
    weights = 1 / np.sqrt(errors.expected[rows])
    count = base.split.end
    here = base.positions[:count]
    tangents = derivatives_of_residuals(base, here, base.tangents[:count])[:, rows]
    residual = base.residual(base.positions)[rows]
    candidates: list[list[np.ndarray]] = [[]]
    for entry in screening.one_per_name:
        if entry.effect.source != "numerical" and np.any(entry.score.amounts):
            signature = np.tensordot(entry.score.amounts, entry.signature, 1)
            candidates.append([base.change(here + signature)[rows]])
    return _scale(base, errors, rows, [_left(residual, [*tangents, *columns], weights) for columns in candidates])


def _scale(
    base: Baseline, errors: ErrorModel, rows: np.ndarray, fits: list[tuple[np.ndarray, np.ndarray]]
) -> Float[np.ndarray, " K"]:  # fmt: skip
    """Twice what the best of several fits leaves in some rows over the numerical error expected there, by kind.

    Args:
        base: the base fit.
        errors: what is expected.
        rows: the residuals.
        fits: what each leaves of them, and the leverage of each residual.
    """
    numerical, out = errors.expected[rows] - 1.0, np.ones(base.modes.count)
    for kind in range(base.modes.count):
        told = (numerical > 1.0) & (base.modes.kinds[rows] == kind)
        frames = np.unique(base.observations.frames[rows][told])
        if len(frames) < NUMERICAL_ERROR.scale_frames:
            continue
        weights = numerical[told] / errors.expected[rows][told] ** 2  # as the likelihood of one scale weighs them
        expected = float(weights @ numerical[told])
        independent = max(len(frames) * float(base.modes.independent[kind]), 1.0)
        shares = []
        for left, leverage in fits:
            free = max(1.0 - float(leverage[told].sum()) / independent, NUMERICAL_ERROR.free_residuals)
            shares.append(max(float(weights @ (left[told] ** 2 - 1.0)), 0.0) / expected / free)
        out[kind] = np.clip(np.sqrt(NUMERICAL_ERROR.scale_margin * min(shares)), NUMERICAL_ERROR.least_scale, 1.0)
    return out


def _left(
    residual: Float[np.ndarray, " n"], columns: list[np.ndarray], weights: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """What a weighted regression on the columns leaves, and the leverage of each row."""
    x = np.stack(columns, axis=1) if columns else np.zeros((len(residual), 0))
    u, s, _ = np.linalg.svd(x * weights[:, None], full_matrices=False)
    u = u[:, s > 1e-8 * s.max(initial=1e-300)]
    left = residual - u @ (u.T @ (residual * weights)) / weights
    return np.asarray(left), np.asarray((u**2).sum(1))
