"""`train.augment` for a whole batch at once, on the device that trains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from models import GREY, mirrored_moments
from train.augment import COLUMN
from train.config import AugmentConfig
from train.motion_states import MIRROR

_GREY_WEIGHTS = (0.2989, 0.587, 0.114)


@dataclass(frozen=True, eq=False)
class Shown:
    """Windows and motion of B clips of T frames."""

    windows: Float[Tensor, "B T W W 4"]
    """0..255."""
    moments: Float[Tensor, "B T M"]
    valid: Bool[Tensor, "B T"]
    interval: Float[Tensor, " B"]
    states: Float[Tensor, "B T S"]


def augment_at_once(shown: Shown, config: AugmentConfig, generator: torch.Generator) -> Shown:
    """All changes of `train.augment.augment`, except those of the mask; depends only on the generator."""
    shown = _in_time(shown, config, generator)
    shown = _flipped(shown, _draw(generator, shown) < config.flip_share)
    noise = config.moment_noise * torch.randn(shown.moments.shape, generator=generator, device=shown.moments.device)
    noise[..., COLUMN["sxx"] : COLUMN["syy"] + 1] *= 0.2
    noise[..., COLUMN["touches_border"]] = 0
    moments = shown.moments + noise * _draw(generator, shown)[:, None, None]
    windows = _colours(_geometry(shown.windows, config, generator), config, generator)
    return replace(shown, moments=moments, windows=windows)


def _draw(generator: torch.Generator, shown: Shown | Tensor) -> Float[Tensor, " B"]:
    like = shown if isinstance(shown, Tensor) else shown.interval
    return torch.rand(len(like), generator=generator, device=like.device)


def _in_time(shown: Shown, config: AugmentConfig, generator: torch.Generator) -> Shown:
    """Later starts, earlier ends, every other frame; the last frame fills the missing ones at the end."""
    frames = shown.valid.shape[1]
    stop = shown.valid.sum(dim=1)
    start = (_draw(generator, shown) * (1 + (stop - 8).clamp(0, config.latest_start))).long()
    cut = (_draw(generator, shown) * (1 + (stop - start) // 3)).long()
    stop = stop - cut * (_draw(generator, shown) < config.shorten_share)
    stride = 1 + ((_draw(generator, shown) < config.stride_share) & (stop - start >= 16)).long()
    count = (stop - start + stride - 1) // stride
    place = torch.arange(frames, device=stop.device)
    index = start[:, None] + stride[:, None] * torch.minimum(place, count[:, None] - 1)
    return Shown(
        windows=_taken(shown.windows, index),
        moments=_referred_moments(_taken(shown.moments, index)),
        valid=place < count[:, None],
        interval=shown.interval * stride,
        states=_referred_states(_taken(shown.states, index)),
    )


def _taken(values: Tensor, index: Int[Tensor, "B T"]) -> Tensor:
    return values[torch.arange(len(index), device=index.device)[:, None], index]


def _referred_moments(moments: Float[Tensor, "B T M"]) -> Float[Tensor, "B T M"]:
    """As `train.augment` refers them to the first frames."""
    left, right, bottom, top = (moments[:, :3, COLUMN[name]] for name in ("left", "right", "bottom", "top"))
    unit = torch.maximum(right - left, top - bottom).median(dim=1).values.clamp(min=0.05)[:, None, None]
    x, y = (moments[:, :1, COLUMN[name], None] for name in ("centroid_x", "centroid_y"))
    zero = torch.zeros_like(x)
    origin = torch.cat([x, y, x, x, y, y, zero, zero, zero, zero, zero], dim=2)
    lengths = COLUMN["sxx"]
    result = moments - origin
    return torch.cat([result[..., :lengths] / unit, result[..., lengths:10] / unit**2, result[..., 10:]], dim=2)


def _referred_states(states: Float[Tensor, "B T S"]) -> Float[Tensor, "B T S"]:
    """As `train.motion_states.referred_states`."""
    eye = torch.eye(3, device=states.device)
    gradient = states[..., 10:].unflatten(-1, (3, 3)) + eye
    left, _, right = torch.linalg.svd(gradient[:, 0])
    gradient = gradient @ (left @ right).mT[:, None] - eye
    return torch.cat([states[..., :3] - states[:, :1, :3], states[..., 3:10], gradient.flatten(-2)], dim=-1)


def _flipped(shown: Shown, chosen: Bool[Tensor, " B"]) -> Shown:
    mirror = torch.from_numpy(MIRROR).to(shown.states.device)
    wide, high = chosen[:, None, None], chosen[:, None, None, None, None]
    return replace(
        shown,
        windows=torch.where(high, shown.windows.flip(3), shown.windows),
        moments=torch.where(wide, mirrored_moments(shown.moments), shown.moments),
        states=torch.where(wide, shown.states * mirror, shown.states),
    )


def _geometry(
    windows: Float[Tensor, "B T W W 4"], config: AugmentConfig, generator: torch.Generator
) -> Float[Tensor, "B T W W 4"]:
    """One zoom and shift for each clip; the coverage a pixel larger or smaller now and then."""
    count, frames, size = windows.shape[:3]
    zoom = (config.zoom * (2 * _draw(generator, windows[:, 0, 0, 0]) - 1)).exp()
    move = 2 * config.shift * (2 * torch.rand(count, 2, generator=generator, device=windows.device) - 1)
    matrix = torch.zeros(count, 2, 3, device=windows.device)
    matrix[:, 0, 0] = matrix[:, 1, 1] = 1 / zoom
    matrix[:, :, 2] = -move / zoom[:, None]
    grid = functional.affine_grid(matrix, [count, 1, size, size], align_corners=False)
    offset = torch.tensor([GREY, GREY, GREY, 0.0], device=windows.device)
    pictures = (windows - offset).movedim(-1, 2).flatten(1, 2)  # [B, T·4, W, W]
    moved = functional.grid_sample(pictures, grid, mode="bilinear", align_corners=False)
    moved = moved.unflatten(1, (frames, 4))
    cover = moved[:, :, 3]
    grown, shrunk = _pooled(cover), 255 - _pooled(255 - cover)
    draw, which = _draw(generator, windows[:, 0, 0, 0]), _draw(generator, windows[:, 0, 0, 0])
    changed = torch.where((which < 0.5)[:, None, None, None], grown, shrunk)
    cover = torch.where((draw < config.mask_share)[:, None, None, None], changed, cover)
    return torch.cat([moved[:, :, :3], cover[:, :, None]], dim=2).movedim(2, -1) + offset


def _pooled(cover: Float[Tensor, "B T W W"]) -> Float[Tensor, "B T W W"]:
    return functional.max_pool2d(cover, 3, stride=1, padding=1)


def _colours(
    windows: Float[Tensor, "B T W W 4"], config: AugmentConfig, generator: torch.Generator
) -> Float[Tensor, "B T W W 4"]:
    """One change of brightness, contrast and saturation for each clip; what is not the object stays mid-grey."""
    rgb, cover = windows[..., :3], windows[..., 3:]
    one = windows[:, 0, 0, 0, 0]
    brightness, contrast, saturation = (
        1 + config.colour * (2 * _draw(generator, one)[:, None, None, None, None] - 1) for _ in range(3)
    )
    saturation = torch.where(
        (_draw(generator, one) < config.grey_share)[:, None, None, None, None], torch.zeros_like(saturation), saturation
    )
    weights = torch.tensor(_GREY_WEIGHTS, device=windows.device)
    rgb = (rgb * brightness).clamp(0, 255)
    mean = (rgb @ weights).mean(dim=(2, 3))[..., None, None, None]
    rgb = (mean + contrast * (rgb - mean)).clamp(0, 255)
    grey = (rgb @ weights)[..., None]
    rgb = (grey + saturation * (rgb - grey)).clamp(0, 255)
    return torch.cat([torch.where(cover > 0, rgb, torch.full_like(rgb, GREY)), cover], dim=-1)
