"""The capture folder: one recorded motion of one object, with cameras, masks, tracks and rest geometry."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from physconvex.capture.folder import Capture, Floor, load_capture
from physconvex.capture.parts import Boundary, Tracks

if TYPE_CHECKING:
    from physconvex.capture.saving import save_capture

__all__ = ["Boundary", "Capture", "Floor", "Tracks", "load_capture", "save_capture"]


def __getattr__(name: str) -> Any:
    """`save_capture` knows the finite elements, which load torch: only writers pay for it."""
    if name == "save_capture":
        return import_module("physconvex.capture.saving").save_capture
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
