"""Comparison of hidden and estimated doses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
