"""Which effects the residual of the base fit asks for: one finite dose of each, and its score."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError
from physconvex.gap.baseline import Baseline, Report
from physconvex.gap.effects import Effect, applicable
from physconvex.gap.model import EffectModel
from physconvex.gap.numerics import Numerics
from physconvex.gap.score import ErrorModel, Projector, Score, score

__all__ = ["Screened", "Screening", "screen"]


@dataclass(frozen=True, eq=False)
class Screened:
    """One effect after screening.

    Attributes:
        effect: the effect.
        score: what the residual of the fitted frames says of it.
        doses: estimate of all its doses, shape [D].
        errors: standard errors of the screened ones, zero for those that only shape it, shape [D].
        signature: what the trial doses do to the observed positions of the fitted frames [m], shape [S, f, P, 3].
        trials: the trial doses, shape [S, D].
        profile: projected and whitened signature along the estimate, for comparing effects, shape [N].
    """

    effect: Effect
    score: Score
    doses: Float[np.ndarray, " D"]
    errors: Float[np.ndarray, " D"]
    signature: Float[np.ndarray, "S f P 3"]
    trials: Float[np.ndarray, "S D"]
    profile: Float[np.ndarray, " N"]

    @property
    def power(self) -> float:
        """Smallest dose of interest over the standard error, of the least certain screened dose."""
        used = self.errors > 0
        smallest = np.array([d.smallest for d in self.effect.doses])
        return float((smallest[used] / self.errors[used]).min()) if used.any() else 0.0


@dataclass(frozen=True, eq=False)
class Screening:
    """All effects, best first; those that could not be simulated; the base model's lack of fit |P r|² and its freedom.

    Attributes:
        ranked: screened effects, the most significant first.
        failed: labels of effects whose trial dose could not be simulated.
        lack_of_fit: square of the whitened, projected residual of the fitted frames.
        freedom: number of residuals less nuisances.
    """

    ranked: tuple[Screened, ...]
    failed: tuple[str, ...]
    lack_of_fit: float
    freedom: int

    @property
    def one_per_name(self) -> tuple[Screened, ...]:
        """The best variant of each effect, best first."""
        best: dict[str, Screened] = {}
        for entry in self.ranked:
            best.setdefault(entry.effect.name, entry)
        return tuple(best.values())

    def similarity(self, first: Screened, second: Screened) -> float:
        """|cosine| of two effects' signatures after projection: 1 = cannot be told apart here."""
        a, b = first.profile, second.profile
        return float(abs(a @ b) / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def screen(
    base: Baseline, errors: ErrorModel, numerics: Numerics, effects: Iterable[Effect], report: Report
) -> Screening:
    """Score every effect that can be tried, on the fitted frames."""
    rows = base.rows(base.split.fitted)
    here, count = base.positions, len(base.tangents)
    nuisances = np.stack([base.change(here[:count] + 1e-3 * d)[rows] / 1e-3 for d in np.moveaxis(base.tangents, 1, 0)])
    projector = Projector(errors.restricted(rows), nuisances)
    residual = base.residual(here)[rows]
    directions = {
        "time_step": numerics.implicit_euler,
        "mesh_resolution": numerics.mesh,
        "reduction": numerics.reduction,
    }
    entries, failed = [], []
    for effect in applicable(effects, base.situation):
        report(f"screening: {effect.label}")
        if effect.source == "numerical" and effect.name in directions and not directions[effect.name].any():
            continue
        model = replace(base.model, frames=count, effects=(effect,), directions=directions)
        try:
            entries.append(_screened(base, model, effect, projector, residual, rows))
        except ConvergenceError:
            failed.append(effect.label)
    ranked = sorted(entries, key=lambda entry: (entry.score.p_value, -entry.score.statistic))
    left = projector.apply(residual)
    return Screening(tuple(ranked), tuple(failed), float(left @ left), len(rows) - projector.rank)


def _screened(
    base: Baseline, model: EffectModel, effect: Effect, projector: Projector, residual: np.ndarray, rows: np.ndarray
) -> Screened:
    null = np.concatenate([base.fit.values, effect.null])
    motion, here = base.motion.first(model.frames), base.positions[: model.frames]
    signatures, trials, signs, screened = [], [], [], []
    for index, doses in effect.trials(base.situation):
        without = np.concatenate([base.fit.values, np.where([d.shape for d in effect.doses], doses, effect.null)])
        changed = np.concatenate([base.fit.values, doses])
        signatures.append(model.signature(changed, without if effect.scene is None else null, motion))
        trials.append(doses)
        signs.append(abs(effect.doses[index].sign))
        screened.append(index)
    signature = np.stack(signatures)
    in_residuals = np.stack([base.change(here + s)[rows] for s in signature])
    found = score(projector, residual, in_residuals, signs)
    doses, errors = np.array(trials[0], copy=True), np.zeros(len(effect.doses))
    for amount, error, index, trial in zip(found.amounts, found.errors, screened, trials, strict=True):
        doses[index], errors[index] = effect.doses[index].estimate(float(amount), float(error), float(trial[index]))
    weights = found.amounts if np.any(found.amounts) else np.ones(len(signature))
    profile = projector.apply(weights @ in_residuals)
    return Screened(effect, found, doses, errors, signature, np.array(trials), profile)
