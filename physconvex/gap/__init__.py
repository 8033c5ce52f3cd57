"""Diagnosis of the sim-to-real gap: where it lies, which unmodelled effect causes it, how far it shrinks.

report = physconvex.diagnose("capture/")
report.verdict.sentence
report.save("diagnosis/")
improved = report.apply()
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
