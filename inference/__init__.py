"""Predict elastic constants and skinning weights: one clip, or folders of clips with result files.

Names are resolved on first use (PEP 562), so that a process that only reads clips stays light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inference.batch import predict_batch
    from inference.prediction import Prediction
    from inference.predictor import predict
    from inference.refining import Refinement, RefineOptions, refine
    from inference.sources import find_sources
    from inference.streaming import ClipResult, iter_predictions
    from inference.summary import BatchSummary

__all__ = [
    "BatchSummary",
    "ClipResult",
    "Prediction",
    "RefineOptions",
    "Refinement",
    "find_sources",
    "iter_predictions",
    "predict",
    "predict_batch",
    "refine",
]

_MODULES = {
    "BatchSummary": "inference.summary",
    "ClipResult": "inference.streaming",
    "Prediction": "inference.prediction",
    "RefineOptions": "inference.refining",
    "Refinement": "inference.refining",
    "find_sources": "inference.sources",
    "iter_predictions": "inference.streaming",
    "predict": "inference.predictor",
    "predict_batch": "inference.batch",
    "refine": "inference.refining",
}


def __getattr__(name: str) -> Any:
    """Import the module of a public name."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value
