"""Where the scan looks: closely around the network's prediction and coarsely everywhere else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from inference.refinement.options import RefineOptions
from physconvex import InputError
from physconvex.identify import scan_values
from physconvex.io import Capture

__all__ = ["ScanRange", "scan_range"]

_RATIOS = (0.25, 0.45)
_LEAST = 0.4  # half width of the scan around a prediction [decades]
_APART = 0.2  # from the predicted interval, of what is scanned besides [decades]


@dataclass(frozen=True)
class ScanRange:
    """What is scanned.

    Attributes:
        moduli: log10 E.
        ratios: ν.
        predicted: ends of the prediction's log10 E, of which a start is kept whatever fits better; None: of none.
        note: for the user, "" for none.
    """

    moduli: tuple[float, ...]
    ratios: tuple[float, ...]
    predicted: tuple[float, float] | None = None
    note: str = ""


def scan_range(capture: Capture, size: float, options: RefineOptions) -> ScanRange:
    """Where to look for the material of a body of that size [m].

    Raises:
        InputError: a prediction was asked for and is impossible.
    """
    gravity = float(np.linalg.norm(capture.gravity))
    everywhere = scan_values(density=capture.density, gravity=gravity, size=size)
    if options.start == "scan" or (options.start == "auto" and not capture.filmed):
        return ScanRange(everywhere, _RATIOS)
    try:
        moduli, ratios = _predicted(capture, options)
    except InputError as error:
        if options.start == "predict":
            raise
        return ScanRange(everywhere, _RATIOS, note=f"The network gave no start ({error}); the whole range was scanned.")
    low, high = moduli[0], moduli[-1]
    beyond = everywhere if options.start == "auto" else ()
    others = [value for value in beyond if not low - _APART <= value <= high + _APART]
    return ScanRange(tuple(sorted((*moduli, *others))), ratios, (low, high))


def _predicted(capture: Capture, options: RefineOptions) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Five moduli over the 90 % interval, enlarged to 0.8 decades at least, and two ratios."""
    from inference.predictor import predict

    found = predict(capture.folder, checkpoint=options.checkpoint, device=options.device)
    low, high = (float(np.log10(v)) for v in found.youngs_modulus_interval)
    middle = 0.5 * (low + high)
    half = max(0.5 * (high - low), _LEAST)
    ratio = float(np.clip(found.poisson_ratio, 0.05, 0.48))
    return tuple(np.linspace(middle - half, middle + half, 5)), tuple(dict.fromkeys((ratio, 0.3, 0.45)))[:2]
