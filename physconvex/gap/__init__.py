"""Diagnosis of the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks.

report = physconvex.diagnose("capture/")
report.verdict.sentence
report.save("diagnosis/")
improved = report.apply()
"""

from physconvex.gap.base.model import EffectModel
from physconvex.gap.diagnose import diagnose
from physconvex.gap.effects import DEFAULT_EFFECTS, Dose, Effect, Motion, Situation, choose
from physconvex.gap.errors.score import ErrorModel, Projector, Score, score
from physconvex.gap.judgement.naming import NamedDose, NamedEffect
from physconvex.gap.judgement.verdict import Verdict
from physconvex.gap.location.where import Part, Where
from physconvex.gap.options import GapOptions
from physconvex.gap.page.report import GapReport, ImprovedTwin
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.shrinkage.how_far import HowFar

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
