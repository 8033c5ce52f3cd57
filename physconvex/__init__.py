"""Material parameters of soft objects from video: one light face over the packages of the repository.

Importing this package loads nothing heavy; the names below are resolved on first use (PEP 562).
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from physconvex.errors import ConvergenceError, InputError, PhysconvexError

_LAZY = {
    "GapReport": "physconvex.gap",
    "PhysicsPredictor": "models",
    "Prediction": "inference",
    "diagnose": "physconvex.gap",
    "RefineOptions": "inference",
    "Refinement": "inference",
    "predict": "inference",
    "predict_batch": "inference",
    "reconstruct": "inference",
    "refine": "inference",
}

__all__ = [
    "ConvergenceError",
    "GapReport",
    "InputError",
    "PhysconvexError",
    "PhysicsPredictor",
    "Prediction",
    "RefineOptions",
    "Refinement",
    "__version__",
    "diagnose",
    "predict",
    "predict_batch",
    "reconstruct",
    "refine",
]

try:
    __version__ = version("physconvex")
except PackageNotFoundError:  # a checkout on the path that was never installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_LAZY[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
