"""What to record next, so that what is left can be told apart."""

from __future__ import annotations

from physconvex.gap.effects.effect import Situation
from physconvex.gap.judgement.verdict_input import Verdict

__all__ = ["next_experiment"]

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


def next_experiment(verdict: Verdict, situation: Situation) -> str:
    """One sentence on what would decide."""
    if verdict.name == "unknown":
        return (
            "Record the same motion again: what returns in a second take is physics, what does not is the recording. "
            "Then look at where the residual starts, in time and on the body."
        )
    names = [effect.name for effect in verdict.effects]
    for effect in verdict.effects:
        names += list(effect.confused_with)
    names = list(dict.fromkeys(names))
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            text = _PAIRS.get(frozenset((first, second)))
            if text:
                return f"To tell {first} from {second}: {text}."
    if verdict.name in ("none", "inconclusive"):
        how = "pull it further before letting go" if situation.clamped else "drop it from twice the height"
        return f"For a sharper answer {how}, or measure with less noise: deviations grow faster than noise does."
    if situation.clamped:
        return "A second take with another amplitude would show whether the dose stays the same."
    return "A second take from another height would show whether the dose stays the same."
