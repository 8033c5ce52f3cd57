"""Expected size of each residual from noise and numerical error, and its actual scale.

**Scale** (`error_scale`). After an impact, meshes of 250 and of 1000 nodes may differ by many times the error of the
finer one, and a smaller effect is lost in that. The residual of the fitted frames contains error and effect. If the
base model, alone or with one effect, leaves a tenth of the expected error, the error is no larger than that tenth
(unless error and effect cancel throughout). As in a regression, the largest model gives the scale of the errors. A
margin prevents a false cause, since an effect absorbs some numerical error by chance. The leverage corrects for what
unknowns absorb of few independent residuals, like degrees of freedom in a regression. Differences between meshes grow
after the fitted frames. Their error there is limited to the residual of the base model, with the same margin. Each kind
of residual (`physconvex.gap.base.body_modes`) has its own scale: a rebound says nothing about strains.
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

    Such errors are smooth, persistent fields. They have few degrees of freedom (`BodyModes.freedom`), shared by several
    frames, so n residuals hold at most about freedom/`lasting` independent ones. The variance is widened by this ratio,
    which gives a smooth signature its proper significance.

    Any model of finite size also gets an error proportional to the distance travelled. For a free body, programs also
    get out of phase after contact, independently of mesh, steps and contact. This error has shares `out_of_step` of the
    distance since contact, of the largest even strain so far, and of the largest finer shape so far. Across the normal
    of the floor it is smaller, since the floor acts there by friction alone.

    If the base model is fitted (its tangents are known), the differences are reduced by what E, ν and the free initial
    motion can absorb, like those of the recording.

    `scale` is a factor on the differences, one or one per residual, see `error_scale`.
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
        whole = base.modes.struck & (base.modes.parts == 0)  # along and across alike, without the share
        come[whole] = (come * count)[whole].sum(0) / count[whole].sum(0)
        strained = mean_of(base.change(here + beyond_rigid(base.motion.rest, base.motion.positions)[0]) ** 2)
        so_far = np.maximum.accumulate(np.where(base.modes.parts[:, None] == 0, come, strained), axis=1)
        sideways = np.where(base.modes.across, min(NUMERICAL_ERROR.sideways + base.situation.friction, 1.0), 1.0)
        phases = (np.array(NUMERICAL_ERROR.out_of_step)[base.modes.parts] * sideways)[:, None] ** 2 * so_far

    def size_of(left: np.ndarray) -> np.ndarray:
        size = np.maximum.accumulate(mean_of((left**2).sum(0)), axis=1)  # an error from impact persists
        return np.asarray((size + floor)[kinds, frames] + np.square(scale) * phases[kinds, frames])

    numerical = size_of(directions)
    if len(base.tangents) == base.model.frames and base.tangents.any():
        numerical = size_of(_absorbed(base, directions, 1.0 + numerical))
    shared = np.maximum(NUMERICAL_ERROR.lasting * count / np.array(base.modes.freedom)[:, None], 1.0)
    return ErrorModel(1.0 + shared[kinds, frames] * numerical, directions, 1.0 + numerical)


def detail_errors(base: Baseline, errors: ErrorModel, share: float) -> ErrorModel:
    """Errors widened by a share of a held body's gap: smaller residuals do not choose between effects.

    Otherwise the frames with the least noise and numerical error, the first ones of a held body, decide alone. No model
    of a recording is as exact as its numerical error, so a slow release or a loosely hanging load would get the effect
    that fits those few frames.
    """
    if not base.situation.clamped:
        return errors
    rows = base.rows(base.split.fitted)
    gap = np.maximum(base.residual(base.positions)[rows] ** 2 - errors.expected[rows], 0.0)
    width = share**2 * float(gap.mean())
    return ErrorModel(errors.variance + width, errors.directions, errors.expected + width)


def _absorbed(base: Baseline, directions: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Differences in all frames, after a fit of the base parameters to them in the fitted frames."""
    here = base.positions
    tangents = derivatives_of_residuals(base, here, base.tangents)
    rows = base.rows(base.split.fitted)
    weights = 1 / np.sqrt(variance[rows])
    found = np.linalg.lstsq((tangents[:, rows] * weights).T, (directions[:, rows] * weights).T, rcond=1e-8)[0]
    return np.asarray(directions - found.T @ tangents)


def path_since_contact(motion: PointMotion, force: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Path of the mean point from the last frame before the first contact to each frame [m]; 0 before.

    A model whose impact is 1 % too strong has an error of 1 % of this path. (The distance from the ballistic path would
    serve as well, but it grows for a body at rest.)

    `force` is the contact force in each frame [N].
    """
    touched = np.flatnonzero(force > 0)
    if not len(touched):
        return np.zeros(len(force))
    last = max(int(touched[0]) - 1, 0)  # last frame of the fall
    steps = np.linalg.norm(np.diff(motion.positions.mean(1), axis=0), axis=1)
    steps[:last] = 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])


def forgiving(errors: ErrorModel, modes: BodyModes) -> ErrorModel:
    """Errors that allow three times the rigid-body error from the first contact on.

    Two programs differ in rigid motion after an impact by 0.3 to 3 % of the path; the evidence assumes 1 %.
    """
    whole = modes.struck & (modes.parts == 0)
    factor = np.where(whole[modes.kinds], NUMERICAL_ERROR.forgiven_rebound**2, 1.0)
    return ErrorModel(1 + factor * (errors.variance - 1), errors.directions, 1 + factor * (errors.expected - 1))


def error_scale(base: Baseline, errors: ErrorModel, screening: Screening) -> Float[np.ndarray, " N"]:
    """Factor on the numerical error of each residual, 0.15 to 1.

    The numerical part of `errors` is from other meshes, steps and contact. Each screened effect may explain its part to
    first order, except numerical ones.
    """
    last, kinds = int(base.split.fitted[-1]), base.modes.kinds
    fitted = _fitted_scale(base, errors, screening)
    rows = base.rows(base.split.selecting)
    unfitted = (base.residual(base.positions)[rows], np.zeros(len(rows)))
    late = np.minimum(fitted, _scale(base, errors, rows, [unfitted]))
    return np.where(base.observations.frames > last, late[kinds], fitted[kinds])


def _fitted_scale(base: Baseline, errors: ErrorModel, screening: Screening) -> Float[np.ndarray, " K"]:
    """Scale by kind, from the fitted frames."""
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
    """Twice the smallest residual of several fits over the expected numerical error, in some rows, by kind.

    Each fit has the residuals and the leverage of each residual.
    """
    numerical, out = errors.expected[rows] - 1.0, np.ones(base.modes.count)
    for kind in range(base.modes.count):
        told = (numerical > 1.0) & (base.modes.kinds[rows] == kind)
        frames = np.unique(base.observations.frames[rows][told])
        if len(frames) < NUMERICAL_ERROR.scale_frames:
            continue
        weights = numerical[told] / errors.expected[rows][told] ** 2  # weights of the likelihood of one scale
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
    """Residual of a weighted regression on the columns, and the leverage of each row."""
    x = np.stack(columns, axis=1) if columns else np.zeros((len(residual), 0))
    u, s, _ = np.linalg.svd(x * weights[:, None], full_matrices=False)
    u = u[:, s > 1e-8 * s.max(initial=1e-300)]
    left = residual - u @ (u.T @ (residual * weights)) / weights
    return np.asarray(left), np.asarray((u**2).sum(1))
