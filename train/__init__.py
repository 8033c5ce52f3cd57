"""Training and evaluation of the predictor on data sets of `data_gen`."""

from importlib import import_module
from typing import Any

_LAZY = {"TrainConfig": "train.config", "load_train_config": "train.config", "train_predictor": "train.loop"}

__all__ = ["TrainConfig", "load_train_config", "train_predictor"]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_LAZY[name]), name)
    globals()[name] = value
    return value
