"""Similarity of two images, and quality of a field in views."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from physconvex.convex import ConvexField
from physconvex.reconstruction.observation import Observation
from physconvex.render import render

WINDOW, SPREAD = 11, 1.5  # pixels; Wang et al. 2004
STABILISERS = (0.01**2, 0.03**2)


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
    """Score and rendered image (clamped to 0 to 1, on the observation's background) of each view.

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


def psnr(image: Float[Tensor, "*pixels 3"], reference: Float[Tensor, "*pixels 3"]) -> float:
    """Peak signal-to-noise ratio −10 log10(mean squared difference) of images, or of pixels, from 0 to 1 [dB]."""
    return float(-10 * torch.log10((image - reference).double().square().mean().clamp(min=1e-12)))


def structural_similarity(image: Float[Tensor, "H W 3"], reference: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Mean SSIM over pixels and channels (Wang et al. 2004): Gaussian windows of 11 pixels, dynamic range 1.

    Differentiable by the first image. Near the border the windows see zeros in both images.
    """
    x, y = image.movedim(-1, 0), reference.movedim(-1, 0)
    parts = torch.cat([x, x * x, x * y])
    fixed = torch.cat([y, y * y]).detach()
    mean_x, square_x, product = _blurred(parts).chunk(3)
    mean_y, square_y = _blurred(fixed).chunk(2)
    c1, c2 = STABILISERS
    variance = (square_x - mean_x**2) + (square_y - mean_y**2)
    covariance = product - mean_x * mean_y
    values = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
    return (values / ((mean_x**2 + mean_y**2 + c1) * (variance + c2))).mean()


def _blurred(images: Float[Tensor, "C H W"]) -> Float[Tensor, "C H W"]:
    """Each as a channel of one image with a kernel of its own: as a batch they take over ten times as long on a CPU."""
    count, line = len(images), _window(images.dtype, images.device)
    down, across = line[:, None].expand(count, 1, -1, 1), line.expand(count, 1, 1, -1)
    rows = functional.conv2d(images[None], down, padding=(WINDOW // 2, 0), groups=count)
    return functional.conv2d(rows, across, padding=(0, WINDOW // 2), groups=count)[0]


@cache
def _window(dtype: torch.dtype, device: torch.device) -> Tensor:
    offset = torch.arange(WINDOW, dtype=torch.float64, device=device) - WINDOW // 2
    values = torch.exp(-offset.square() / (2 * SPREAD**2))
    return (values / values.sum()).to(dtype)
