"""Where the scan looks: around the network's prediction, or everywhere."""

from __future__ import annotations

import numpy as np

from inference.refining.options import RefineOptions
from physconvex.capture import Capture
from physconvex.errors import InputError
from physconvex.identify import Twin, scan_values

__all__ = ["scan_range"]

_RATIOS = (0.25, 0.45)
_LEAST = 0.4  # half width of the scan around a prediction [decades]


def scan_range(
    capture: Capture, twin: Twin, options: RefineOptions
) -> tuple[tuple[float, ...], tuple[float, ...], str]:
    """log10 E and ν of the scan, and a note for the user ("" for none).

    Raises:
        InputError: a prediction was asked for and is impossible.
    """
    if options.start == "scan" or (options.start == "auto" and not capture.cameras):
        return (*_everywhere(capture, twin), "")
    try:
        return (*_predicted(capture, options), "")
    except InputError as error:
        if options.start == "predict":
            raise
        return (*_everywhere(capture, twin), f"The network gave no start ({error}); the whole range was scanned.")


def _everywhere(capture: Capture, twin: Twin) -> tuple[tuple[float, ...], tuple[float, ...]]:
    gravity = float(np.linalg.norm(capture.gravity))
    return scan_values(density=capture.density, gravity=gravity, size=twin.mesh.size), _RATIOS


def _predicted(capture: Capture, options: RefineOptions) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Five moduli over the 90 % interval, enlarged to 0.8 decades at least."""
    from inference.predictor import predict

    found = predict(capture.folder, checkpoint=options.checkpoint)
    low, high = (float(np.log10(v)) for v in found.youngs_modulus_interval)
    middle = 0.5 * (low + high)
    half = max(0.5 * (high - low), _LEAST)
    ratio = float(np.clip(found.poisson_ratio, 0.05, 0.48))
    return tuple(np.linspace(middle - half, middle + half, 5)), tuple(dict.fromkeys((ratio, 0.3, 0.45)))[:2]
