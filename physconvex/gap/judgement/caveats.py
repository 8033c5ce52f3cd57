"""Additions to a verdict: its limits, the detectable doses, and the next recording."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from physconvex.gap.base.baseline import FLOOR_LAW
from physconvex.gap.base.model import MODULUS
from physconvex.gap.effects.effect import Situation
from physconvex.gap.errors.screening import Screening
from physconvex.gap.judgement.naming import Verdict
from physconvex.gap.search.hypothesis import Hypothesis, doses_at_bounds
from physconvex.gap.thresholds import SCREENING, VERDICT

_PAIRS: dict[frozenset[str], str] = {
    frozenset(pair): text
    for pair, text in (
        (("damping", "viscoelasticity"), "a slow push and a fast drop of the same body: a relaxation time shows as "
         "stiffness that depends on the rate"),
        (("damping", "time_step"), "nothing new: run the model with half the time step; numerical damping halves, "
         "the body's does not"),
        (("damping", "restitution"), "more frames after lift-off: contact damping ends with the contact, viscosity "
         "does not"),
        (("damping", "air_drag"), "a drop from twice the height: drag grows with speed and shows before the first "
         "contact"),
        (("gravity_tilt", "wind"), "the body at rest on the floor, or a heavier body of the same shape: tilt does not "
         "depend on mass"),
        (("gravity_tilt", "friction"), "a free flight without contact, or a level with a plumb line in view"),
        (("gravity_tilt", "camera_pose"), "a plumb line or the floor's edge in view, measured before the motion"),
        (("initial_velocity", "time_offset"), "a second take with another initial velocity, or a trigger visible in "
         "the first frame"),
        (("air_drag", "time_scale"), "a clock in view, or a rigid ball dropped beside the body"),
        (("anisotropy", "heterogeneity"), "the same drop in another orientation: fibres turn with the body, and so "
         "does an inclusion, but only fibres are alike everywhere"),
        (("nonlinear_elasticity", "contact_stiffness"), "a low and a high drop: stiffening grows with the amplitude"),
        (("nonlinear_elasticity", "anisotropy"), "a low and a high drop: fibres stiffen small motions as well"),
        (("friction", "initial_spin"), "frames before the first contact: spin shows there, friction does not"),
        (("plasticity", "viscoelasticity"), "frames until the body rests: what has yielded stays, what crept recovers"),
    )
}  # fmt: skip


def doses_in_sight(screening: Screening) -> tuple[str, ...]:
    """Detectable doses: three standard errors, for the best visible effects with one dose."""
    limits = []
    for entry in sorted(screening.one_per_name, key=lambda e: -e.power):
        screened = np.flatnonzero(entry.errors > 0)
        dose = entry.effect.doses[int(screened[0])] if len(screened) == 1 else None
        if dose is not None and not dose.threshold and entry.effect.source != "numerical":
            unit = f" {dose.unit}" if dose.unit else ""
            limits.append(f"{entry.effect.name} {SCREENING.in_sight * float(entry.errors[screened[0]]):.2g}{unit}")
    return (f"Doses from which on an effect would have been seen here: {', '.join(limits[:6])}.",) if limits else ()


def caveats_of(base: Hypothesis, best: Hypothesis, after: float) -> tuple[str, ...]:
    """Limits of a verdict."""
    out = ["Density and E cannot be told apart from motion: E holds for the stated density."]
    out += _floor(base)
    out += _elements(base)
    if MODULUS in base.model.base:
        index = base.model.base.index(MODULUS)
        moved = float(best.values[index] - base.values[index])
        if abs(moved) > np.log10(1 + VERDICT.absorbed):
            changed = f"E changed by {10**moved - 1:+.0%} when the effect was added"
            out.append(f"{changed}: the plain model's E had absorbed part of it.")
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
    """Deviations that are attributed to the program of the recording."""
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
    """Deviations that are attributed to the floor."""
    if FLOOR_LAW[0] not in base.model.base:
        return []
    stiffness, dashpot = (base.values[base.model.base.index(name)] for name in FLOOR_LAW)
    return [
        f"The floor gives way: its stiffness ({10**stiffness:.2g} Pa/m) and dashpot ({1e3 * dashpot:.2g} ms) were "
        "fitted beside E: the capture does not state them. If the real floor is hard, read the "
        "dashpot as `restitution`."
    ]


def next_experiment(verdict: Verdict, situation: Situation) -> str:
    """One sentence on the recording that would decide."""
    if verdict.name == "unknown":
        return (
            "Record the same motion again: what returns in a second take is physics, what does not is the recording. "
            "Then look at where the residual starts, in time and on the body."
        )
    confused = (name for effect in verdict.effects for name in effect.confused_with)
    names = dict.fromkeys([*(effect.name for effect in verdict.effects), *confused])
    for first, second in combinations(names, 2):
        if text := _PAIRS.get(frozenset((first, second))):
            return f"To tell {first} from {second}: {text}."
    if verdict.name in ("none", "inconclusive"):
        how = "pull it further before letting go" if situation.clamped else "drop it from twice the height"
        return f"For a sharper answer {how}, or measure with less noise: deviations grow faster than noise does."
    if situation.clamped:
        return "A second take with another amplitude would show whether the dose stays the same."
    return "A second take from another height would show whether the dose stays the same."
