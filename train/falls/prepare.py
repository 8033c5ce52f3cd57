"""`models.clip.prepare_clip` for many clips at once, with torch, for known silhouettes."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from models import GREY, ClipConfig

_FIRST = 3  # frames that give the unit of length, as in models.silhouette and models.windows


def prepare_clips_at_once(
    images: Float[Tensor, "B T S S 3"], masks: Float[Tensor, "B T S S"], settings: ClipConfig
) -> tuple[Float[Tensor, "B T W W 4"], Float[Tensor, "B T M"]]:
    """Windows (0..255) and moments: square about the path, silhouettes measured in it, windows that follow the object.

    Args:
        images: 0..255.
        masks: 0 or 1; every frame should show the object.
        settings: sizes.
    """
    corner, side = _crop(masks, settings.margin)
    size = settings.image_size
    shown = torch.cat([(images - GREY) * masks[..., None], 255 * masks[..., None]], dim=-1).movedim(-1, 2)
    step = (side / size)[:, None, None]
    start = corner[:, None] + step[..., 0, None] / 2 - 0.5
    square = _sampled(shown, start.expand(-1, masks.shape[1], -1), step.expand(-1, masks.shape[1], -1), size)
    mask = square[:, :, 3].round() / 255
    raw = _pixel_moments(mask)
    touches = _touches_border(masks)
    moments = torch.cat([_dimensionless(raw), touches[..., None].float()], dim=-1)
    edge = settings.extent * _unit(square[:, :, 3] > 127)
    step = (edge / settings.window)[:, None, None]
    start = raw[..., :2] - (edge / 2)[:, None, None] + step / 2 - 0.5
    windows = _sampled(square, start, step.expand(-1, masks.shape[1], -1), settings.window)
    windows[:, :, :3] += GREY
    return windows.movedim(2, -1).round().clamp(0, 255), moments


def _crop(masks: Tensor, margin: float) -> tuple[Float[Tensor, "B 2"], Float[Tensor, " B"]]:
    """Upper left corner and edge of the square around the object's whole path [px]."""
    union = masks.amax(dim=1) > 0
    (x0, x1), (y0, y1) = _span(union.any(dim=1)), _span(union.any(dim=2))
    side = (torch.maximum(x1 - x0, y1 - y0) * (1 + 2 * margin)).round().clamp(min=4)
    return torch.stack([((x0 + x1 - side) / 2).round(), ((y0 + y1 - side) / 2).round()], dim=1), side


def _span(profile: Tensor) -> tuple[Tensor, Tensor]:
    """First place that is set along the last axis, and one beyond the last."""
    values = profile.float()
    return values.argmax(dim=-1).float(), profile.shape[-1] - values.flip(-1).argmax(dim=-1).float()


def _sampled(
    pictures: Float[Tensor, "B T C S S"], start: Float[Tensor, "B T 2"], step: Float[Tensor, "B T 1"], size: int
) -> Float[Tensor, "B T C R R"]:
    """Bilinear, zero outside; `start` is where the first pixel of the result looks, in numbers of pixels."""
    count, frames, channels, side = pictures.shape[:4]
    places = start[..., None] + step[..., None] * torch.arange(size, device=pictures.device)  # [B, T, 2, R]
    places = (2 * places + 1) / side - 1
    x, y = places[:, :, 0, None, :].expand(-1, -1, size, -1), places[:, :, 1, :, None].expand(-1, -1, -1, size)
    grid = torch.stack([x, y], dim=-1).flatten(0, 1)
    found = functional.grid_sample(pictures.flatten(0, 1), grid, mode="bilinear", align_corners=False)
    return found.view(count, frames, channels, size, size)


def _touches_border(masks: Tensor) -> Tensor:
    sides = (masks[:, :, 0], masks[:, :, -1], masks[:, :, :, 0], masks[:, :, :, -1])
    return torch.stack([side.amax(dim=-1) > 0 for side in sides]).any(dim=0)


def _unit(shown: Tensor) -> Tensor:
    """Larger edge of the silhouette's box [px], median over the first frames."""
    first = shown[:, :_FIRST]
    (x0, x1), (y0, y1) = _span(first.any(dim=2)), _span(first.any(dim=3))
    return torch.maximum(x1 - x0, y1 - y0).median(dim=1).values.clamp(min=4)


def _pixel_moments(mask: Float[Tensor, "B T S S"]) -> Float[Tensor, "B T 10"]:
    """As `models.silhouette._pixel_moments`."""
    places = torch.arange(mask.shape[-1], device=mask.device) + 0.5
    columns, rows = mask.sum(dim=2), mask.sum(dim=3)
    area = rows.sum(dim=-1)
    safe = area.clamp(min=1e-9)
    cx, cy = columns @ places / safe, rows @ places / safe
    dx, dy = places - cx[..., None], places - cy[..., None]
    left, right = _edges(mask.amax(dim=2))
    top, bottom = _edges(mask.amax(dim=3))
    xx, yy = (columns * dx**2).sum(dim=-1) / safe, (rows * dy**2).sum(dim=-1) / safe
    xy = torch.einsum("btyx,bty,btx->bt", mask, dy, dx) / safe
    return torch.stack([cx, cy, left, right, bottom, top, area, xx, xy, yy], dim=-1)


def _edges(cover: Float[Tensor, "B T S"]) -> tuple[Tensor, Tensor]:
    """As `models.silhouette._edges`."""
    first, last = _span(cover >= 0.5)
    last = last - 1
    padded = functional.pad(cover, (1, 1))

    def at(place: Tensor) -> Tensor:
        return padded.gather(-1, place.long()[..., None])[..., 0]

    before, after = at(first), at(last + 2)
    low = first + 1 - at(first + 1) - before * (before < 0.5)
    high = last + at(last + 1) + after * (after < 0.5)
    return low, high


def _dimensionless(raw: Float[Tensor, "B T 10"]) -> Float[Tensor, "B T 10"]:
    """As `models.silhouette._dimensionless`."""
    first = raw[:, :_FIRST]
    unit = torch.maximum(first[..., 3] - first[..., 2], first[..., 4] - first[..., 5]).median(dim=1).values.clamp(min=1)
    unit = unit[:, None, None]
    x, y = raw[:, :1, :1], raw[:, :1, 1:2]
    sign = torch.tensor([1.0, -1.0, 1.0], device=raw.device)
    parts = [
        (raw[..., :1] - x) / unit,
        (y - raw[..., 1:2]) / unit,
        (raw[..., 2:4] - x) / unit,
        (y - raw[..., 4:6]) / unit,
        raw[..., 6:7].sqrt() / unit,
        raw[..., 7:10] / unit**2 * sign,
    ]
    return torch.cat(parts, dim=-1)
