"""From fits to a verdict, by a list of rules."""

from __future__ import annotations

from collections.abc import Sequence

from physconvex.gap.effects.effect import IN_FLIGHT
from physconvex.gap.errors.screening import Screening
from physconvex.gap.judgement.naming import SOMETHING_ELSE, Verdict, beside_something_else, favoured, probabilities
from physconvex.gap.judgement.residual_measures import Measured
from physconvex.gap.judgement.verdict_input import VerdictInput
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.thresholds import VERDICT


def decide(
    hypotheses: Sequence[Hypothesis], screening: Screening, measured: Measured, options: GapOptions
) -> Verdict:  # fmt: skip
    """The verdict of the first rule that holds, from the base model and fits, best evidence first."""
    base = next(h for h in hypotheses if not h.effects)
    best = favoured(hypotheses)
    shown = probabilities(hypotheses, measured.other)
    if best is None:
        none = beside_something_else(shown, 0.0).get("base model", 0.0)
        return Verdict("inconclusive", "No effect could be tried on this capture.", (), none, 0.0, ())
    flies = measured.flight >= VERDICT.telling and any(effect.source in IN_FLIGHT for effect in best.effects)
    probability = beside_something_else(shown, 1.0 if flies else measured.share)
    case = VerdictInput(base, best, tuple(hypotheses), screening, probability, measured, options, flies)
    rules = (
        _wide_open, _nothing, _slight, _numerical, _weak, _off_the_recording, _unexplained, _as_good_as_a_placebo,
        _hurried,
    )  # fmt: skip
    verdict = next((found for rule in rules if (found := rule(case)) is not None), None) or _called(case)
    return _open_flight(case) if verdict.name in ("none", "inconclusive") and case.flight_is_open else verdict


def _wide_open(e: VerdictInput) -> Verdict | None:
    """A gap far above any error of the model, which the best effects leave."""
    return _unknown(e) if e.left_wide_open and not e.flies else None


def _nothing(e: VerdictInput) -> Verdict | None:
    """No gap above noise and numerical error; inconclusive if these are large.

    An effect that shows clearly in flight counts even if later frames are uncertain.
    """
    if e.flies and not e.best.is_slight():
        return None
    significant = min(e.screening.ranked[0].score.p_value * len(e.screening.ranked), 1.0) < e.options.significance
    # a fit can find more than one finite dose does
    significant = (
        significant or (e.gain >= VERDICT.telling and e.telling) or (e.foretold and e.measured.seen >= VERDICT.seen)
    )
    closed = min(e.measured.before, e.base.fitted) < VERDICT.floor and not e.telling
    little = e.gain < VERDICT.weak and e.measured.before < VERDICT.open
    slight = e.best.is_slight() and not e.open and not e.foretold
    late = e.telling and e.measured.before >= VERDICT.open  # predicted, after the fitted frames
    if not (little or slight or (not late and (closed or not significant))):
        return None
    if e.measured.floor > VERDICT.blind:
        return _blind(e)
    if e.open and not e.best.is_slight():
        sentence = (
            "Inconclusive: a gap opens after the frames that were fitted, above noise and numerical error, and "
            f"{e.best.label}, which fits best, does not foretell it."
        )
        return e.verdict("inconclusive", sentence, power=True)
    reason = "lies within these errors" if closed else "is no more than chance"
    if e.best.is_slight():
        reason = "is smaller than is of interest"
    sentence = f"No gap above noise and numerical error: what {e.best.label} would add {reason}."
    return e.verdict("none", sentence, power=True)


def _slight(e: VerdictInput) -> Verdict | None:
    """A dose below the smallest of interest fits best, and leaves the gap."""
    if not e.best.is_slight() or e.foretold:
        return None
    if e.measured.floor > VERDICT.blind:
        return _blind(e)
    sentence = (
        f"Inconclusive: there is a gap above noise and numerical error, but what fits it best, {e.best.label}, is "
        "smaller than is of interest and leaves it."
    )
    return e.verdict("inconclusive", sentence, power=True)


def _blind(e: VerdictInput) -> Verdict:
    sentence = (
        f"Inconclusive: the model's own numerical error and the noise ({e.measured.floor:.0%} of the body's size or "
        "motion) hide whatever gap there is. Allow a finer mesh, or record a motion with less contact."
    )
    return e.verdict("inconclusive", sentence, power=True)


def _numerical(e: VerdictInput) -> Verdict | None:
    """All effects of the best fit are numerical; inconclusive if such errors are large."""
    if any(effect.source != "numerical" for effect in e.best.effects):
        return None
    if e.measured.floor > VERDICT.blind:
        return _blind(e)
    if e.open:
        sentence = (
            f"Inconclusive: numerical error ({e.best.label}) fits best, but leaves a gap above noise and what "
            "else this model errs by."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    sentence = (
        f"No physical cause: what the recording differs by is numerical error ({e.best.label}), of this model or of "
        "the program that made the recording."
    )
    return e.verdict("none", sentence, e.possible)


def _weak(e: VerdictInput) -> Verdict | None:
    """A gain below the threshold of a call."""
    if e.clear:
        return None
    sentence = (
        f"Inconclusive: {e.best.label} is favoured, but the recording cannot tell it from no effect that is known "
        f"(probability {e.probability[e.best.label]:.0%} against {e.none:.0%} for none)."
    )
    return e.verdict("inconclusive", sentence, e.possible, power=True)


def _off_the_recording(e: VerdictInput) -> Verdict | None:
    """The model does not fit this recording at all."""
    if e.measured.astray <= VERDICT.astray:
        return None
    sentence = (
        f"The model does not follow the recording: with {e.best.label} it is still off by {e.measured.astray:.0%} of "
        "the motion. Check rest geometry, boundary, units, frame rate and gravity before looking for an effect."
    )
    return e.verdict("unknown", sentence)


def _unexplained(e: VerdictInput) -> Verdict | None:
    """A gap that the best effects leave; the part within the model's own error needs no explanation."""
    explained = max(e.measured.share, e.measured.above_error) >= e.options.explained
    if explained or e.measured.after <= VERDICT.left_over or e.flies:
        return None
    if e.measured.struck and (e.best.fitted < VERDICT.floor or e.measured.forgiven <= VERDICT.left_over):
        sentence = (
            f"Inconclusive: with {e.best.label} the model fits as well as it can err, and later parts from the "
            "recording: an unknown effect would do so, and so would a rebound that is a little off."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    return _unknown(e)


def _unknown(e: VerdictInput) -> Verdict:
    sentence = (
        "There is a gap that none of the known effects explains: on frames that were not fitted it is "
        f"{e.measured.seen:.1f} times what noise and numerical error lead one to expect, and the best of them, "
        f"{e.best.label}, removes {max(e.measured.share, 0):.0%} of it."
    )
    return e.verdict("unknown", sentence, e.possible)


def _open_flight(e: VerdictInput) -> Verdict:
    """In flight the model error is negligible, whatever an impact hides."""
    sentence = (
        "There is a gap that none of the known effects explains: before the first contact, where this model errs by "
        f"next to nothing, each of them leaves at least {e.measured.flight_left:.0f} times the square that noise leads "
        "one to expect."
    )
    return e.verdict("unknown", sentence, e.possible)


def _as_good_as_a_placebo(e: VerdictInput) -> Verdict | None:
    """A placebo effect does nearly as much, or the best one does nothing on held-out frames."""
    certain, m = bool(e.named) and min(n.probability for n in e.named) >= VERDICT.certain, e.measured
    leaves_little = 1.0 - m.share <= VERDICT.placebo_left * (1.0 - m.placebo)
    if e.flies or ((certain or m.share >= VERDICT.foretold) and leaves_little):
        return None
    nothing = m.share <= 0 or (m.reported <= 0 and m.after > VERDICT.left_over)
    if not (nothing or m.placebo > VERDICT.placebo * m.share):
        return None
    if nothing:
        sentence = (
            f"Inconclusive: {e.best.label} fits best, but removes nothing of the gap on frames that were not fitted."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    sentence = (
        f"Inconclusive: {e.best.label} fits best and removes {m.share:.0%} of the gap on frames that were not fitted, "
        f"but an effect that the recording does not ask for removes {m.placebo:.0%} as well."
    )
    return e.verdict("inconclusive", sentence, e.possible)


def _hurried(e: VerdictInput) -> Verdict | None:
    """Effects with a high rank were not tried, so the best of the others is no cause yet."""
    if not e.measured.hurried:
        return None
    sentence = (
        f"Inconclusive: the clock ended the search before all effects that the recording asks for were tried; of those "
        f"that were, {e.best.label} fits best. Diagnose again while the machine does less, or with a later deadline."
    )
    return e.verdict("inconclusive", sentence, e.possible)


def _called(e: VerdictInput) -> Verdict:
    """The best effects are the cause."""
    likely = tuple(n for n in e.named if n.probability >= VERDICT.likely) or (
        max(e.named, key=lambda n: n.probability),
    )  # of several similar effects none may reach half, but together they do
    if e.probability.get(SOMETHING_ELSE, 0.0) + e.none >= VERDICT.doubt and not (e.foretold or e.flies):
        shares = ", ".join(f"{n.name} {n.probability:.0%}" for n in e.possible)
        sentence = (
            f"Inconclusive: there is a gap, and {e.best.label} fits best, but leaves so much that "
            f"it may well be none of them ({shares}; something else {e.probability.get(SOMETHING_ELSE, 0.0):.0%})."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    doses = "; ".join(f"{d.name} = {d.value:.3g} {d.unit}".strip() for n in likely for d in n.doses)
    also = sorted({name for n in likely for name in n.confused_with})
    caveat = f"; from this recording it may be confused with {', '.join(also)}" if also else ""
    perhaps = [f"{n.name} ({VERDICT.trusted * n.probability:.0%})" for n in e.named if n not in likely]
    soft = e.best.model.situation.in_soft_floor  # further effects may follow the error of its contact law
    perhaps += [f"{n.name} ({'or the floor' if soft else f'{VERDICT.trusted * n.probability:.0%}'})" for n in e.further]
    added = f"; perhaps also by {', '.join(perhaps)}" if perhaps else ""
    label = " + ".join(x.label for x in e.best.effects if x.name in {n.name for n in likely})
    sure = ", ".join(f"{VERDICT.trusted * n.probability:.0%}" for n in likely)
    sentence = f"The gap is caused by {label} (probability {sure}): {doses}{added}{caveat}."
    return e.verdict("effect", sentence, e.possible)
