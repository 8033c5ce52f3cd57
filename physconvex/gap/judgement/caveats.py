"""What goes with a verdict: its limits, and which doses would have been seen."""

from __future__ import annotations

import numpy as np

from physconvex.gap.errors.screening import Screening
from physconvex.gap.search.hypothesis import Hypothesis, doses_at_bounds
from physconvex.gap.thresholds import SCREENING, VERDICT

__all__ = ["caveats_of", "doses_in_sight"]


def doses_in_sight(screening: Screening) -> tuple[str, ...]:
    """Which doses would have been seen: three standard errors, of the effects with one dose that are seen best."""
    limits = []
    for entry in sorted(screening.one_per_name, key=lambda e: -e.power):
        screened = np.flatnonzero(entry.errors > 0)
        dose = entry.effect.doses[int(screened[0])] if len(screened) == 1 else None
        if dose is not None and not dose.threshold and entry.effect.source != "numerical":
            unit = f" {dose.unit}" if dose.unit else ""
            limits.append(f"{entry.effect.name} {SCREENING.in_sight * float(entry.errors[screened[0]]):.2g}{unit}")
    return (f"Doses from which on an effect would have been seen here: {', '.join(limits[:6])}.",) if limits else ()


def caveats_of(base: Hypothesis, best: Hypothesis, after: float) -> tuple[str, ...]:
    """What limits an answer."""
    out = ["Density and E cannot be told apart from motion: E holds for the stated density."]
    out += _floor(base)
    out += _elements(base)
    moved = _moved(base, best)
    if moved is not None and abs(moved) > np.log10(1 + VERDICT.absorbed):
        out.append(
            f"E changed by {10**moved - 1:+.0%} when the effect was added: the plain model's E had absorbed part of it."
        )
    if any(effect.source == "numerical" for effect in best.effects):
        out.append(
            "The best explanation is a numerical error, of this model or of the program that made the recording."
        )
    at_bounds = doses_at_bounds(best)
    if at_bounds:
        out.append(
            f"At the bound of what is physical: {', '.join(at_bounds)}. That effect stands for something else, which "
            "the dictionary does not have or the other effects do not describe well."
        )
    if after > VERDICT.open:
        out.append("What is left after the best effect is still well above noise and numerical error.")
    return tuple(out)


def _elements(base: Hypothesis) -> list[str]:
    """What was taken for a property of the program that made the recording."""
    mesh = base.model.mesh
    if mesh is None or mesh.order != 1:
        return []
    out = [
        "The model has the linear elements of the capture's own mesh, which fit better than other ones: the "
        "program that made the recording seems to have used them."
    ]
    if mesh.mass_shares is not None:
        out.append(
            "All of its nodes have the same mass, as particles of such a program do, since that fits better than mass "
            "where the elements are. A real load near a free end may look alike."
        )
    return out


def _floor(base: Hypothesis) -> list[str]:
    """What was taken as a property of the floor."""
    names = base.model.base
    if "contact_damping" not in names:
        return []
    stiffness = 10 ** base.values[names.index("log10_contact_stiffness")]
    dashpot = base.values[names.index("contact_damping")]
    return [
        f"The floor gives way: its stiffness ({stiffness:.2g} Pa/m) and dashpot ({1e3 * dashpot:.2g} ms) were "
        "fitted beside E: the capture does not state them. If the real floor is hard, read the "
        "dashpot as `restitution`."
    ]


def _moved(base: Hypothesis, best: Hypothesis) -> float | None:
    names = base.model.base
    if "log10_youngs_modulus" not in names:
        return None
    index = names.index("log10_youngs_modulus")
    return float(best.values[index] - base.values[index])
