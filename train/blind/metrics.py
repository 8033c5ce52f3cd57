"""Figures of merit of blind answers, each with its statistical uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, mannwhitneyu

_BINS = 10


@dataclass(frozen=True)
class Proportion:
    """A share of a number of captures, with its 95 % interval (Wilson 1927); NaN without captures."""

    value: float
    count: int
    lower: float
    upper: float

    def __str__(self) -> str:
        if not self.count:
            return "-"
        return f"{self.value:.2f} [{self.lower:.2f}, {self.upper:.2f}] of {self.count}"


def proportion(hits: Sequence[bool]) -> Proportion:
    """Proportion of hits among captures."""
    if not hits:
        return Proportion(float("nan"), 0, float("nan"), float("nan"))
    found = binomtest(sum(map(bool, hits)), len(hits)).proportion_ci(0.95, method="wilson")
    return Proportion(float(np.mean(hits)), len(hits), float(found.low), float(found.high))


@dataclass(frozen=True)
class Bin:
    """Answers with a probability in one tenth: their mean probability, and the share that is right."""

    probability: float
    right: float
    count: int


def reliability(probabilities: Sequence[float], right: Sequence[bool]) -> tuple[Bin, ...]:
    """Ten bins of equal width, without the empty ones."""
    p, hit = np.asarray(probabilities, dtype=float), np.asarray(right, dtype=float)
    place = np.minimum((p * _BINS).astype(int), _BINS - 1)
    return tuple(
        Bin(float(p[place == i].mean()), float(hit[place == i].mean()), int((place == i).sum()))
        for i in np.unique(place)
    )


def calibration_error(bins: Sequence[Bin]) -> float:
    """Expected calibration error (Naeini et al. 2015): mean difference of probability and share over answers."""
    total = sum(b.count for b in bins)
    return sum(b.count * abs(b.probability - b.right) for b in bins) / total if total else float("nan")


def area_under_roc(positive: Sequence[float], negative: Sequence[float]) -> float:
    """Probability that a score is larger for a positive than for a negative, ties half (Mann & Whitney 1947)."""
    if not len(positive) or not len(negative):
        return float("nan")
    return float(mannwhitneyu(positive, negative).statistic) / (len(positive) * len(negative))
