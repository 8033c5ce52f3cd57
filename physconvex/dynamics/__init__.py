"""Loads on a body and time integration: contact, friction, wind, integrators, stepping."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
