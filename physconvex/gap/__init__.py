"""Diagnosis of the sim-to-real gap: where it lies, which unmodelled effect causes it, how far that effect reduces it.

`physconvex.diagnose("capture/")` returns a `GapReport`: its `verdict`, `save` and `apply`, the model with the effects.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
