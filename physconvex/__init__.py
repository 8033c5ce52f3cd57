"""Material parameters of soft objects from video: the main functions of the repository.

The library logs its progress to the logger "physconvex", which is silent unless a program configures it. Names are
loaded on first use (PEP 562); `__init__.pyi` holds their types.
"""

import logging
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

from physconvex.errors import ConvergenceError, InputError, PhysconvexError

_LAZY = {
    "GapReport": ("physconvex.gap", "GapReport"),
    "PhysicsPredictor": ("models", "PhysicsPredictor"),
    "Prediction": ("inference", "Prediction"),
    "Reconstruction": ("inference", "Reconstruction"),
    "ReconstructOptions": ("inference", "ReconstructOptions"),
    "RefineOptions": ("inference", "RefineOptions"),
    "Refinement": ("inference", "Refinement"),
    "diagnose": ("physconvex.gap", "diagnose"),
    "predict": ("inference", "predict"),
    "predict_batch": ("inference", "predict_batch"),
    "reconstruct": ("inference", "reconstruct"),
    "refine": ("inference", "refine"),
    "simulate": ("physconvex.play", "simulate_assets"),
}

__all__ = ["ConvergenceError", "InputError", "PhysconvexError", "__version__", *_LAZY]

logging.getLogger("physconvex").addHandler(logging.NullHandler())

try:
    __version__ = version("physconvex")
except PackageNotFoundError:  # a checkout on the path that was never installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    package, there = _LAZY[name]
    value: object = getattr(import_module(package), there)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
