"""One capture of a blind bank: hidden effects, answer, and the correct parts of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_gen import OUTSIDE, same_class
from physconvex.gap import VERDICT

# effects with another form in the explicit engine than in the dictionary: their doses are other quantities
OTHER_FORM = frozenset({"air_drag", "viscoelasticity", "nonlinear_elasticity", "heterogeneity", "anisotropy"})
_LOG = "log10 "


@dataclass(frozen=True)
class DoseScore:
    """Doses of one named effect.

    Attributes:
        error: |told - hidden| over |hidden|, the largest among doses of one unit, which count as a vector.
        covered: for every dose, whether its 90 % interval contains the hidden one.
    """

    error: float
    covered: tuple[bool, ...]


@dataclass(frozen=True)
class Row:
    """Label and answer of one capture.

    Attributes:
        capture, kind: name of the bank and of the capture, and drop, throw or clamped.
        truth: hidden effects.
        doses: their doses, with units.
        visibility: requested visibility.
        without: effects that are removed from the dictionary.
        verdict: verdict of the answer; "error" without one.
        first: effects that lead the best fits, without repetition.
        fit: effects of the best fit.
        probability: stated for the class of the first effect that is named or remains possible; NaN if there is none.
        named: that effect.
        numerical: whether it is a numerical one.
        known: probability of the likeliest effect by the fits alone, independent of the verdict.
        dose: dose of the first named effect, if it is the hidden one.
        shrinkage, placebo: of the held-out gap.
        oracle: shrinkage with the hidden effect as the only one; NaN if not run.
        gap_before, gap_after, noise_floor: of held-out frames, rms [m].
        bias_log10_youngs_modulus, bias_poisson_ratio: before and after.
        seconds: duration of the diagnosis.
        error: message.
    """

    capture: str
    kind: str
    truth: tuple[str, ...]
    doses: tuple[tuple[float, str], ...]
    visibility: float
    without: tuple[str, ...]
    verdict: str
    first: tuple[str, ...] = ()
    fit: tuple[str, ...] = ()
    probability: float = float("nan")
    named: str = ""
    numerical: bool = False
    known: float = 0.0
    dose: DoseScore | None = None
    shrinkage: float = float("nan")
    placebo: float = float("nan")
    oracle: float = float("nan")
    gap_before: float = float("nan")
    gap_after: float = float("nan")
    noise_floor: float = float("nan")
    bias_log10_youngs_modulus: tuple[float, float] = (float("nan"),) * 2
    bias_poisson_ratio: tuple[float, float] = (float("nan"),) * 2
    seconds: float = float("nan")
    error: str = ""

    @property
    def outside(self) -> bool:
        """Whether the hidden effect is outside the dictionary of its diagnosis."""
        return bool(set(self.truth) & {*OUTSIDE, *self.without})

    @property
    def single(self) -> bool:
        """Whether one effect of the dictionary is hidden."""
        return len(self.truth) == 1 and not self.outside

    @property
    def alarm(self) -> bool:
        """Whether a cause is called."""
        return self.verdict == "effect"

    @property
    def right_first(self) -> bool:
        """Whether the hidden effect's class leads the fits."""
        return self.among(1)

    def among(self, count: int) -> bool:
        """Whether the hidden effect's class is among the first `count`."""
        return bool(self.truth) and any(same_class(name, self.truth[0]) for name in self.first[:count])

    @property
    def called(self) -> bool:
        """Whether it is the called cause."""
        return self.alarm and self.named_right

    @property
    def named_right(self) -> bool:
        """Whether the effect with the stated probability is hidden."""
        return any(same_class(self.named, name) for name in self.truth)

    @property
    def told_right(self) -> bool:
        """Whether the effect with the stated probability is present: hidden, or the other engine's numerical error."""
        return self.named_right or (self.numerical and not self.truth and not self.alarm)

    @property
    def unknown_score(self) -> float:
        """One less the probability of the likeliest known effect.

        This score separates known classes from unknown ones (Hendrycks & Gimpel, ICLR 2017).
        """
        return 1.0 - self.known

    @property
    def right(self) -> bool:
        """Whether the answer is the desired one."""
        if not self.truth:
            return not self.alarm
        return self.verdict == "unknown" if self.outside else self.called

    @property
    def recall(self) -> float:
        """Share of the hidden effects in the best fit, classes merged."""
        return share_of(self.truth, self.fit)

    @property
    def precision(self) -> float:
        """Share of the best fit's effects that are hidden, classes merged."""
        return share_of(self.fit, self.truth)


def score_doses(name: str, hidden: Sequence[tuple[float, str]], told: Sequence[dict[str, Any]]) -> DoseScore | None:
    """Compare in order; None if the two are not the same quantities.

    Args:
        name: name of the effect.
        hidden: doses and units.
        told: parameters of the answer: `unit`, `value`, `interval`.
    """
    if name in OTHER_FORM or not told:
        return None
    groups: dict[str, list[tuple[float, float]]] = {}
    covered = []
    for (value, unit), answer in zip(hidden, told, strict=False):
        log = answer["unit"] == f"{_LOG}{unit}"
        if not log and answer["unit"] != unit:
            return None
        found, low, high = (10.0**v if log else v for v in (answer["value"], *answer["interval"]))
        groups.setdefault(unit, []).append((value, found))
        covered.append(bool(low <= value <= high))
    errors = []
    for pairs in groups.values():
        true, found = np.array(pairs).T
        errors.append(float(np.linalg.norm(found - true)) / max(float(np.linalg.norm(true)), 1e-300))
    return DoseScore(max(errors), tuple(covered))


def share_of(names: Sequence[str], among: Sequence[str]) -> float:
    """Share of names that are in the class of one of the others."""
    return float(np.mean([any(same_class(name, other) for other in among) for name in names])) if names else 0.0


def scored_row(
    label: dict[str, Any], answer: dict[str, Any] | None, without: Sequence[str], *, oracle: float, bank: str
) -> Row:
    """Combine a label and an answer.

    Args:
        label: label from the seal.
        answer: answer to the capture; None without one.
        without: effects that are removed from the dictionary for the whole bank.
        oracle: see `Row`.
        bank: name that prefixes the capture's.
    """
    name = f"{bank}/{label['capture']}"
    truth = tuple(effect["name"] for effect in label["effects"])
    doses = tuple(pair for e in label["effects"] for pair in zip(e["doses"], e["units"], strict=True))
    wanted = float(label.get("wanted", label.get("visibility") or float("nan")))
    gone = tuple(dict.fromkeys([*without, *(answer or {}).get("without", ())]))
    if answer is None or "error" in answer:
        error = "no answer" if answer is None else answer["error"]
        return Row(name, label["kind"], truth, doses, wanted, gone, "error", error=error)
    ranking = [names for names in answer["ranking"] if names]
    named = answer["effects"][0] if answer["effects"] else None
    same = named is not None and len(truth) == 1 and named["name"] == truth[0]
    return Row(
        name, label["kind"], truth, doses, wanted, gone, answer["verdict"],
        first=tuple(dict.fromkeys(names[0] for names in ranking)),
        fit=tuple(ranking[0]) if ranking else (),
        probability=_told(answer["effects"]),
        named="" if named is None else named["name"],
        numerical=named is not None and named["source"] == "numerical",
        known=answer["known"],
        dose=score_doses(truth[0], doses, named["parameters"]) if same and named is not None else None,
        shrinkage=answer["shrinkage"],
        placebo=float("nan") if answer["placebo"] is None else answer["placebo"],
        oracle=oracle,
        gap_before=answer["gap_before"], gap_after=answer["gap_after"], noise_floor=answer["noise_floor"],
        bias_log10_youngs_modulus=_bias(answer["log10_youngs_modulus"], float(np.log10(label["youngs_modulus"]))),
        bias_poisson_ratio=_bias(answer["poisson_ratio"], label["poisson_ratio"]),
        seconds=answer["seconds"],
    )  # fmt: skip


def _told(effects: Sequence[dict[str, Any]]) -> float:
    """Probability of the first effect's class: the sum over its effects, up to the maximum of any call.

    An answer of the class is right, so the probabilities of a tilt and a wind with the same signature count together.
    """
    alike = [e["probability"] for e in effects if same_class(e["name"], effects[0]["name"])]
    return min(sum(alike), max(VERDICT.trusted, alike[0])) if alike else float("nan")


def _bias(values: Sequence[float], true: float) -> tuple[float, float]:
    return values[0] - true, values[1] - true
