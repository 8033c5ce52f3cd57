"""Observed, rendered and difference, side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from physconvex.reconstruction import Observation

__all__ = ["write_comparison"]

_GAIN = 4.0  # of the difference


def write_comparison(path: Path, seen: Observation, rendered: torch.Tensor) -> None:
    """Write one PNG: the view, the rendered image [H, W, 3], four times their absolute difference on black."""
    difference = (_GAIN * (rendered - seen.image).abs()).clamp(0, 1)
    row = torch.cat([seen.image, rendered.clamp(0, 1), difference], dim=1)
    Image.fromarray((255 * row.numpy()).round().astype(np.uint8)).save(path)
