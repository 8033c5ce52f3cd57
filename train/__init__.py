"""Training and evaluation of the predictor on data sets of `data_gen`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
