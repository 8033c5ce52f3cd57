"""Screening: one finite dose of each effect, and its score against the residual of the base fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline, Report, derivatives_of_residuals
from physconvex.gap.base.model import EffectModel
from physconvex.gap.effects.catalogue import applicable
from physconvex.gap.effects.effect import Effect
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.errors.score_test import ErrorModel, Projector, Score, least_squares, score_effect


@dataclass(frozen=True, eq=False)
class Screened:
    """One effect after screening.

    Attributes:
        effect: the effect.
        score: score from the residual of the fitted frames.
        doses: estimate of all its doses, shape [D].
        errors: standard errors of the screened doses, zero for shape doses, shape [D].
        signature: change of the observed positions of the fitted frames by the trial doses [m], shape [S, f, P, 3].
        trials: the trial doses, shape [S, D].
        profile: projected and whitened signature along the estimate, for comparing effects, shape [N].
        projected: projected and whitened signatures, shape [S, N].
        signs: +1 if only multiples ≥ 0 of a signature make sense, else 0.
    """

    effect: Effect
    score: Score
    doses: Float[np.ndarray, " D"]
    errors: Float[np.ndarray, " D"]
    signature: Float[np.ndarray, "S f P 3"]
    trials: Float[np.ndarray, "S D"]
    profile: Float[np.ndarray, " N"]
    projected: Float[np.ndarray, "S N"]
    signs: tuple[int, ...]

    @property
    def power(self) -> float:
        """Smallest dose of interest over the standard error, of the least certain screened dose."""
        used = self.errors > 0
        smallest = np.array([d.smallest for d in self.effect.doses])
        return float((smallest[used] / self.errors[used]).min()) if used.any() else 0.0


@dataclass(frozen=True, eq=False)
class Screening:
    """Ranked effects, failed effects, and the residual.

    Attributes:
        ranked: screened effects, the most significant first.
        failed: labels of effects whose trial dose cannot be simulated.
        left: whitened and projected residual of the fitted frames, shape [N].
    """

    ranked: tuple[Screened, ...]
    failed: tuple[str, ...]
    left: Float[np.ndarray, " N"]

    @property
    def one_per_name(self) -> tuple[Screened, ...]:
        """The best variant of each effect, best first."""
        best: dict[str, Screened] = {}
        for entry in self.ranked:
            best.setdefault(entry.effect.name, entry)
        return tuple(best.values())

    def similarity(self, first: Screened, second: Screened) -> float:
        """|cosine| of two effects' signatures after projection; 1 for effects that this capture cannot distinguish."""
        a, b = first.profile, second.profile
        return float(abs(a @ b) / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def screen(
    base: Baseline, errors: ErrorModel, numerics: Numerics, effects: Iterable[Effect], report: Report
) -> Screening:
    """Score every applicable effect on the fitted frames."""
    rows = base.rows(base.split.fitted)
    here, count = base.positions, base.split.end
    nuisances = derivatives_of_residuals(base, here[:count], base.tangents[:count])[:, rows]
    projector = Projector(errors.restricted(rows), nuisances)
    residual = base.residual(here)[rows]
    directions = numerics.directions
    entries, failed = [], []
    for effect in applicable(effects, base.situation):
        if effect.name in {e.name for e in base.model.effects}:
            continue
        report(f"screening: {effect.label}")
        if effect.source == "numerical" and effect.name in directions and not directions[effect.name].any():
            continue
        model = replace(base.model, frames=count, effects=(*base.model.effects, effect), directions=directions)
        try:
            entries.append(_screened(base, model, effect, projector, residual, rows=rows))
        except (ConvergenceError, InputError, np.linalg.LinAlgError):
            failed.append(effect.label)
    ranked = sorted(entries, key=lambda entry: (entry.score.p_value, -entry.score.statistic))
    return Screening(tuple(ranked), tuple(failed), projector.apply(residual))


def _screened(
    base: Baseline, model: EffectModel, effect: Effect, projector: Projector, residual: np.ndarray, *, rows: np.ndarray
) -> Screened:
    null = np.concatenate([base.fit.values, effect.null])
    motion, here = base.motion.first(model.frames), base.positions[: model.frames]
    screened, trials = zip(*effect.trials(base.situation), strict=True)
    signs = tuple(abs(effect.doses[index].sign) for index in screened)
    signatures = []
    for doses in trials:
        without = np.concatenate([base.fit.values, np.where([d.shape for d in effect.doses], doses, effect.null)])
        changed = np.concatenate([base.fit.values, doses])
        signatures.append(model.signature(changed, without if effect.scene is None else null, motion))
    signature = np.stack(signatures)
    if not np.isfinite(signature).all():
        raise ConvergenceError(f"{effect.label}: the motion is not finite")
    in_residuals = np.stack([base.change(here + s)[rows] for s in signature])
    found = score_effect(projector, residual, in_residuals, signs)
    doses, errors = np.array(trials[0], copy=True), np.zeros(len(effect.doses))
    for amount, error, index, trial in zip(found.amounts, found.errors, screened, trials, strict=True):
        doses[index], errors[index] = effect.doses[index].estimate(float(amount), float(error), float(trial[index]))
    weights = found.amounts if np.any(found.amounts) else np.ones(len(signature))
    projected = projector.apply(in_residuals)
    profile = weights @ projected
    return Screened(effect, found, doses, errors, signature, np.array(trials), profile, projected, signs)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two screened effects with the doses and the statistic of their joint score."""

    first: Screened
    second: Screened
    statistic: float


def best_pairs(screening: Screening, count: int) -> list[Pair]:
    """Pairs of effects that together explain most, by one regression each, with doses set to its result.

    Some effects help only together: damping of the right strength cannot show while a load keeps the frequency wrong.
    """
    entries, left = screening.ranked, screening.left
    rows = np.concatenate([entry.projected for entry in entries]) if entries else np.zeros((0, len(left)))
    gram, right, total = rows @ rows.T, rows @ left, float(left @ left)
    ends = np.cumsum([0, *(len(entry.projected) for entry in entries)])
    found: list[tuple[float, Screened, Screened, np.ndarray]] = []
    for (i, first), (j, second) in combinations(enumerate(entries), 2):
        if first.effect.name == second.effect.name or "numerical" in (first.effect.source, second.effect.source):
            continue
        index = np.r_[ends[i] : ends[i + 1], ends[j] : ends[j + 1]]
        amounts, explained = _joint(gram[np.ix_(index, index)], right[index], total, first.signs + second.signs)
        if np.any(amounts[: len(first.signs)]) and np.any(amounts[len(first.signs) :]):
            found.append((explained, first, second, amounts))
    best: dict[frozenset[str], Pair] = {}
    for explained, first, second, amounts in sorted(found, key=lambda row: -row[0]):
        names = frozenset((first.effect.name, second.effect.name))
        if names not in best and len(best) < count:
            cut = len(first.signs)
            best[names] = Pair(_dosed(first, amounts[:cut]), _dosed(second, amounts[cut:]), explained)
    return list(best.values())


def _joint(gram: np.ndarray, right: np.ndarray, total: float, signs: tuple[int, ...]) -> tuple[np.ndarray, float]:
    """Amounts of several signatures and the explained part, from inner products alone."""
    values, vectors = np.linalg.eigh(gram + 1e-10 * np.trace(gram) * np.eye(len(gram)))
    root = (vectors * np.sqrt(np.maximum(values, 1e-300))).T  # rootᵀ root = gram
    target = np.linalg.lstsq(root.T, right, rcond=None)[0]
    amounts = least_squares(root.T, target, signs)
    return amounts, float(min(2 * amounts @ right - amounts @ gram @ amounts, total))


def _dosed(entry: Screened, amounts: np.ndarray) -> Screened:
    """The same effect with the doses of a joint regression."""
    doses = entry.doses.copy()
    screened = [i for i, dose in enumerate(entry.effect.doses) if not dose.shape]
    for amount, index, trial in zip(amounts, screened, entry.trials, strict=True):
        doses[index] = entry.effect.doses[index].estimate(float(amount), 0.0, float(trial[index]))[0]
    return replace(entry, doses=doses)
