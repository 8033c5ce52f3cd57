"""Diagnosis of the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks.

report = physconvex.diagnose("capture/")
report.verdict.sentence
report.save("diagnosis/")
improved = report.apply()
"""

from physconvex.gap.comparison import Hypothesis
from physconvex.gap.diagnose import diagnose
from physconvex.gap.effects import DEFAULT_EFFECTS, Dose, Effect, Motion, Situation, choose
from physconvex.gap.how_far import HowFar
from physconvex.gap.model import EffectModel
from physconvex.gap.naming import NamedDose, NamedEffect
from physconvex.gap.options import GapOptions
from physconvex.gap.report import GapReport, ImprovedTwin
from physconvex.gap.score import ErrorModel, Projector, Score, score
from physconvex.gap.verdict import Verdict
from physconvex.gap.where import Part, Where

__all__ = [
    "DEFAULT_EFFECTS",
    "Dose",
    "Effect",
    "EffectModel",
    "ErrorModel",
    "GapOptions",
    "GapReport",
    "HowFar",
    "Hypothesis",
    "ImprovedTwin",
    "Motion",
    "NamedDose",
    "NamedEffect",
    "Part",
    "Projector",
    "Score",
    "Situation",
    "Verdict",
    "Where",
    "choose",
    "diagnose",
    "score",
]
