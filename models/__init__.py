"""Clip preparation, network, heads, calibration and checkpoints.

Names are loaded on first use (PEP 562).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
