"""Simulated and rendered training data: random drops of soft bodies, data sets and captures.

The names below are resolved on first use (PEP 562), so that readers of data sets do not load the renderer.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
