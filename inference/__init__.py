"""Predict elastic constants and skinning weights of clips; reconstruct objects; with result files.

Names are resolved on first use (PEP 562), so that a process that only reads clips stays light.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
