"""Full-order finite elements: the physical truth that the rest of physconvex is measured against."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
