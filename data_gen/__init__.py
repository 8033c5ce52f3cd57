"""Simulated and rendered training data: falls of random soft bodies, data sets and captures.

Names are loaded on first use (PEP 562), so a reader of data sets does not load the renderer.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
