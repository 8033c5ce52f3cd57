"""Simulated and rendered training data: random drops of soft bodies, data sets and captures.

The names below are resolved on first use (PEP 562), so that readers of data sets do not load the renderer.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from data_gen.captures import RingOptions, generate_captures
    from data_gen.config import GeneratorConfig, load_config
    from data_gen.dataset import ClipRecord, Dataset
    from data_gen.generate import GenerationSummary, generate_dataset
    from data_gen.lighting import Backdrop, Lighting
    from data_gen.objects import ObjectMesh, load_user_mesh, random_object
    from data_gen.render import Renderer
    from data_gen.surface import Surface

_LAZY = {
    "Backdrop": "lighting",
    "ClipRecord": "dataset",
    "Dataset": "dataset",
    "GenerationSummary": "generate",
    "GeneratorConfig": "config",
    "Lighting": "lighting",
    "ObjectMesh": "objects",
    "Renderer": "render",
    "RingOptions": "captures",
    "Surface": "surface",
    "generate_captures": "captures",
    "generate_dataset": "generate",
    "load_config": "config",
    "load_user_mesh": "objects",
    "random_object": "objects",
}

__all__ = [
    "Backdrop",
    "ClipRecord",
    "Dataset",
    "GenerationSummary",
    "GeneratorConfig",
    "Lighting",
    "ObjectMesh",
    "Renderer",
    "RingOptions",
    "Surface",
    "generate_captures",
    "generate_dataset",
    "load_config",
    "load_user_mesh",
    "random_object",
]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"data_gen.{_LAZY[name]}"), name)
