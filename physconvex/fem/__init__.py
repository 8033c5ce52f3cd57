"""Full-order finite elements: the reference for all other models of physconvex."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
