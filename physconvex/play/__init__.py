"""Play an object: from a mesh file and a description of material, forces and floor to its motion on disk."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
