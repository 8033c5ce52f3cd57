"""How well a field explains views."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.similarity import psnr, structural_similarity
from physconvex.render import render

__all__ = ["ViewScore", "score_views"]


@dataclass(frozen=True)
class ViewScore:
    """One view.

    Attributes:
        camera: its name.
        psnr: over the whole image [dB].
        psnr_object: over the pixels that the object covers at least in part [dB].
        ssim: mean structural similarity.
        mask_iou: intersection over union of alpha and mask (sums of least and of greatest values).
    """

    camera: str
    psnr: float
    psnr_object: float
    ssim: float
    mask_iou: float


@torch.no_grad()
def score_views(field: ConvexField, observations: Iterable[Observation]) -> list[tuple[ViewScore, Tensor]]:
    """Score and rendered image (clamped to 0 to 1, before the observation's background) of each view.

    Drawn on the field's device; the images are on the CPU.
    """
    found = []
    for seen in (one.to(field.points.device) for one in observations):
        image = render(field, seen.view, background=seen.background)
        colour, reference = image.colour.clamp(0, 1), seen.image
        inside = seen.coverage > 0
        overlap = torch.minimum(image.alpha, seen.coverage).sum() / torch.maximum(image.alpha, seen.coverage).sum()
        result = ViewScore(
            seen.camera.name,
            psnr(colour, reference),
            psnr(colour[inside], reference[inside]),
            float(structural_similarity(colour, reference)),
            float(overlap),
        )
        found.append((result, colour.cpu()))
    return found
