from inference import (
    Prediction as Prediction,
    Reconstruction as Reconstruction,
    ReconstructOptions as ReconstructOptions,
    Refinement as Refinement,
    RefineOptions as RefineOptions,
    predict as predict,
    predict_batch as predict_batch,
    reconstruct as reconstruct,
    refine as refine,
)
from models import PhysicsPredictor as PhysicsPredictor
from physconvex.errors import (
    ConvergenceError as ConvergenceError,
    InputError as InputError,
    PhysconvexError as PhysconvexError,
)
from physconvex.gap import GapReport as GapReport, diagnose as diagnose
from physconvex.play import simulate_assets as simulate

__all__ = [
    "ConvergenceError",
    "GapReport",
    "InputError",
    "PhysconvexError",
    "PhysicsPredictor",
    "Prediction",
    "ReconstructOptions",
    "Reconstruction",
    "RefineOptions",
    "Refinement",
    "__version__",
    "diagnose",
    "predict",
    "predict_batch",
    "reconstruct",
    "refine",
    "simulate",
]

__version__: str
