"""Named effects that a base model may lack, each with its doses and its place in the simulators."""

from physconvex.gap.effects.catalogue import DEFAULT_EFFECTS, EFFECT_NAMES, applicable, choose
from physconvex.gap.effects.effect import IN_FLIGHT, Dose, Effect, Patches, Situation, Source
from physconvex.gap.effects.motion import Correction, Motion, by_steps

__all__ = [
    "DEFAULT_EFFECTS",
    "EFFECT_NAMES",
    "IN_FLIGHT",
    "Correction",
    "Dose",
    "Effect",
    "Motion",
    "Patches",
    "Situation",
    "Source",
    "applicable",
    "by_steps",
    "choose",
]
