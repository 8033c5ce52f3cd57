"""Test-time refinement: a capture → material, motion and their uncertainty."""

from inference.refining.options import RefineOptions
from inference.refining.pipeline import refine
from inference.refining.result import Estimate, RefinedMotion, Refinement
from inference.refining.writing import write_refinement

__all__ = ["Estimate", "RefineOptions", "RefinedMotion", "Refinement", "refine", "write_refinement"]
