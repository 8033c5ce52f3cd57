"""Prediction from clips, refinement of captures, reconstruction of objects, and their result files.

Names are loaded on first use (PEP 562), so a process that only reads clips does not load the network.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
