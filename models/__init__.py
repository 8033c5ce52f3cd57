"""Clip preparation, network, heads, calibration and checkpoints.

Names are resolved on first use (PEP 562).
"""

from importlib import import_module
from typing import Any

_LAZY = {
    "BinnedDensity": "models.heads",
    "Calibration": "models.calibration",
    "ClipConfig": "models.clip",
    "Estimate": "models.estimator",
    "NetworkConfig": "models.config",
    "PhysicsNetwork": "models.network",
    "PhysicsPredictor": "models.estimator",
    "PreparedClip": "models.clip",
    "SkinningField": "models.skinning",
    "captured_energy": "models.skinning_energy",
    "freeze_time": "models.clip",
    "prepare_clip": "models.clip",
    "random_basis": "models.skinning_energy",
    "shuffle_time": "models.clip",
}

__all__ = [
    "BinnedDensity",
    "Calibration",
    "ClipConfig",
    "Estimate",
    "NetworkConfig",
    "PhysicsNetwork",
    "PhysicsPredictor",
    "PreparedClip",
    "SkinningField",
    "captured_energy",
    "freeze_time",
    "prepare_clip",
    "random_basis",
    "shuffle_time",
]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_LAZY[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
