"""From views to a static convex field."""

from physconvex.reconstruction.config import ReconstructionConfig, load_reconstruction_config
from physconvex.reconstruction.coverage import Coverage, Holes, SoftSurface, measure_coverage, measure_holes
from physconvex.reconstruction.filling import fill_gaps
from physconvex.reconstruction.fit import FitState, Progress, begin, fit, image_loss
from physconvex.reconstruction.observation import Observation, observe
from physconvex.reconstruction.refine import Refinement, hidden, refine, simplify
from physconvex.reconstruction.scores import ViewScore, score
from physconvex.reconstruction.similarity import psnr, structural_similarity
from physconvex.reconstruction.start import Start, body_surface, start_field, start_kind
from physconvex.reconstruction.visual_hull import visual_hull

__all__ = [
    "Coverage",
    "FitState",
    "Holes",
    "Observation",
    "Progress",
    "ReconstructionConfig",
    "Refinement",
    "SoftSurface",
    "Start",
    "ViewScore",
    "begin",
    "body_surface",
    "fill_gaps",
    "fit",
    "hidden",
    "image_loss",
    "load_reconstruction_config",
    "measure_coverage",
    "measure_holes",
    "observe",
    "psnr",
    "refine",
    "score",
    "simplify",
    "start_field",
    "start_kind",
    "structural_similarity",
    "visual_hull",
]
