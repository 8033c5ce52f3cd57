"""Blending of polygons in plain torch: the definition and the reference for every kernel."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.render.projection import Splats

LEAST_ALPHA = 1 / 255  # fainter contributions are skipped
GREATEST_ALPHA = 0.99  # no convex hides everything behind it, so that the blending is differentiable
LEAST_TRANSMITTANCE = 1e-4  # blending stops below it
BLOCK = 32  # pixels are drawn in squares of this size, each with the polygons that can reach it


@dataclass(frozen=True, eq=False)
class Layers:
    """Blended features of every pixel.

    Attributes:
        features: Σ_i w_i features_i with w_i = a_i Π_(j<i) (1 − a_j), shape [H, W, 4].
        transmittance: Π (1 − a_i), visible share of the background, shape [H, W].
        heaviest: place among the splats of the greatest weight w_i, −1 without any, shape [H, W].
    """

    features: Float[Tensor, "H W 4"]
    transmittance: Float[Tensor, "H W"]
    heaviest: Int[Tensor, "H W"]


def composite_reference(splats: Splats, coordinates: Float[Tensor, "H W 2"]) -> Layers:
    """Blend polygons front to back at pixels with the given coordinates on the plane at unit distance.

    a = min(opacity · sigmoid(−β log Σ_h exp s_h), 0.99), and zero below 1/255 and where the transmittance so far is
    below 1e-4.
    """
    if not len(splats):
        nothing = sum(tensor.sum() for tensor in splats.differentiable()) + 0.0 * coordinates.sum(dim=-1)
        return Layers(nothing[..., None].expand(*nothing.shape, 4), nothing + 1.0, torch.full_like(nothing, -1).long())
    place, padded = _padded(splats)
    rows = []
    for strip in coordinates.split(BLOCK):
        rows.append(_joined([_blend(splats, place, padded, block) for block in strip.split(BLOCK, dim=1)], dim=1))
    return _joined(rows, dim=0)


def _joined(parts: list[Layers], dim: int) -> Layers:
    """Parts of an image side by side or one above the other."""
    return Layers(*(torch.cat([getattr(part, entry.name) for part in parts], dim=dim) for entry in fields(Layers)))


def _padded(splats: Splats) -> tuple[Int[Tensor, "M H"], Tensor]:
    """For every polygon its lines, and the empty places of the list."""
    number = splats.starts.diff()
    place = torch.arange(int(number.max()), device=number.device)
    missing = place >= number[:, None]
    return (splats.starts[:-1, None] + place).masked_fill(missing, 0), missing


def _within_reach(splats: Splats, place: Tensor, missing: Tensor, block: Float[Tensor, "h w 2"]) -> Int[Tensor, " m"]:
    """Polygons that may be visible in a block: by a bound, since log Σ_h exp s_h ≥ max_h s_h, which is linear."""
    low, high = block.detach().amin(dim=(0, 1)), block.detach().amax(dim=(0, 1))
    normals, offsets = splats.lines.detach()[:, :2], splats.lines.detach()[:, 2]
    least = torch.minimum(normals * low, normals * high).sum(dim=1) + offsets
    least = least[place].masked_fill(missing, -torch.inf).amax(dim=1)
    # opacity · sigmoid(−β s) ≥ 1/255  ⇔  β s ≤ log(255 opacity − 1); with some slack for rounding
    reach = (splats.opacity.detach() / LEAST_ALPHA - 1).clamp(min=0).log()
    return (splats.sharpness.detach() * least <= reach + 1e-3 * (1 + reach.abs())).nonzero()[:, 0]


def _blend(splats: Splats, place: Tensor, missing: Tensor, block: Float[Tensor, "h w 2"]) -> Layers:
    """One block of pixels."""
    chosen = _within_reach(splats, place, missing, block)
    if not len(chosen):
        empty = block.sum(dim=-1) * 0.0
        return Layers(empty[..., None].expand(*empty.shape, 4), empty + 1.0, torch.full_like(empty, -1).long())
    lines = splats.lines[place[chosen]]
    scaled = torch.einsum("yxi,mhi->yxmh", block, lines[..., :2]) + lines[..., 2]
    smooth = torch.logsumexp(scaled.masked_fill(missing[chosen], -torch.inf), dim=-1)
    alpha = splats.opacity[chosen] * torch.sigmoid(-splats.sharpness[chosen] * smooth)
    alpha = alpha.clamp(max=GREATEST_ALPHA)
    alpha = torch.where(alpha < LEAST_ALPHA, torch.zeros_like(alpha), alpha)
    before = torch.cumprod(torch.cat([torch.ones_like(alpha[..., :1]), 1 - alpha[..., :-1]], dim=-1), dim=-1)
    alpha = torch.where(before < LEAST_TRANSMITTANCE, torch.zeros_like(alpha), alpha)
    weights = alpha * before
    most, which = weights.detach().max(dim=-1)
    return Layers(weights @ splats.features[chosen], (1 - alpha).prod(dim=-1), torch.where(most > 0, chosen[which], -1))
