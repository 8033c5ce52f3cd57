"""Reduced-order simulator: a body moved by M skinning weights, φ(X) = X + Σ_m W_m(X) Z_m [X; 1]."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
