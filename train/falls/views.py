"""Falls as clips: each with a camera, colours, and a silhouette as accurate as the finder's."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from data_gen import LOOK, VIEW, CameraConfig, DrawnClips, render_falls
from train.falls.world import Falls, Index

_POINTS = 64  # of a surface, that the camera keeps in sight


@dataclass(frozen=True, eq=False)
class Views:
    """Pictures of B clips, and where their cameras look from."""

    images: Float[Tensor, "B T S S 3"]
    """0..255."""
    masks: Float[Tensor, "B T S S"]
    """0 or 1: plausible output of a finder."""
    turn: Float[Tensor, "B 3 3"]
    """Rows: to the right in the picture, away from the camera, up (`train.records.camera_aligned_axes`)."""


def draw_views(
    falls: Falls, chosen: Index, config: CameraConfig, generator: torch.Generator, *, side: int = 128
) -> Views:
    """One random view of each chosen fall, as the generator draws cameras (`data_gen.scene`)."""
    device = falls.positions.device
    azimuth = _uniform(generator, len(chosen), config.azimuth_deg.low, config.azimuth_deg.high, device).deg2rad()
    views = _views(falls, chosen, config, azimuth, generator=generator, side=side)
    looks = _looks(len(chosen), azimuth, generator, device)
    batch = DrawnClips(falls.clips[chosen], views, looks, falls.positions, falls.rest, falls.triangles)
    drawn = render_falls(batch, side=side, factor=2)
    images = drawn[..., :3]
    noise = _uniform(generator, len(chosen), 0.0, 6.0, device)
    images = images + noise[:, None, None, None, None] * torch.randn(images.shape, generator=generator, device=device)
    zero, one = torch.zeros_like(azimuth), torch.ones_like(azimuth)
    rows = [azimuth.cos(), -azimuth.sin(), zero, azimuth.sin(), azimuth.cos(), zero, zero, zero, one]
    turn = torch.stack(rows, dim=1).unflatten(1, (3, 3))
    return Views(images.clamp(0, 255), _found(drawn[..., 3], generator), turn)


def _uniform(generator: torch.Generator, count: int, low: float, high: float, device: torch.device) -> Tensor:
    return low + (high - low) * torch.rand(count, generator=generator, device=device)


def _views(
    falls: Falls, chosen: Index, config: CameraConfig, azimuth: Tensor, *, generator: torch.Generator, side: int
) -> Float[Tensor, "B T 16"]:
    """The nearest camera on each drawn ray that keeps all points within the margin (`data_gen.scene._camera`)."""
    device, count = azimuth.device, len(chosen)
    elevation = _uniform(generator, count, config.elevation_deg.low, config.elevation_deg.high, device).deg2rad()
    field = _uniform(generator, count, config.field_of_view_deg.low, config.field_of_view_deg.high, device).deg2rad()
    margin = _uniform(generator, count, config.margin.low, config.margin.high, device)
    focal = 0.5 * side / (field / 2).tan()
    clips = falls.clips[chosen].long()
    share = torch.rand(count, _POINTS, generator=generator, device=device)
    corner = falls.triangles[(clips[:, 2:3] + (share * clips[:, 3:4]).long()), 0].long()  # [B, points]
    frame = torch.arange(falls.frames, device=device)
    first = 3 * (clips[:, :1, None] * falls.frames + frame[None, :, None] * clips[:, 1:2, None] + corner[:, None])
    points = torch.stack([falls.positions[first + k] for k in range(3)], dim=-1).flatten(1, 2)  # [B, T·points, 3]
    low, high = points.amin(dim=1), points.amax(dim=1)
    extent = (high - low).amax(dim=1)
    jitter = 2 * torch.rand(count, 3, generator=generator, device=device) - 1
    target = (low + high) / 2 + config.aim_jitter * extent[:, None] * jitter
    forward = torch.stack([azimuth.sin() * elevation.cos(), azimuth.cos() * elevation.cos(), -elevation.sin()], dim=1)
    right = torch.stack([azimuth.cos(), -azimuth.sin(), torch.zeros_like(azimuth)], dim=1)
    up = torch.linalg.cross(right, forward)
    offset = points - target[:, None]
    across, upwards, along = (torch.einsum("bpi,bi->bp", offset, axis) for axis in (right, up, forward))
    reach = torch.maximum(across.abs(), upwards.abs()) * (2 * focal / side * margin)[:, None]
    distance = torch.maximum((reach - along).amax(dim=1), 1.5 * extent)
    eye = target - distance[:, None] * forward
    shake = _shake(count, falls.frames, side, generator, device)
    parts = [right, -up, forward, eye, focal[:, None]]
    fixed = torch.cat(parts, dim=1)[:, None].expand(-1, falls.frames, -1)
    factor = torch.full((count, falls.frames, 1), 2.0, device=device)
    views = torch.cat([fixed, side / 2 + shake, factor], dim=2).contiguous()
    assert views.shape[2] == VIEW
    return views


def _shake(count: int, frames: int, side: int, generator: torch.Generator, device: torch.device) -> Tensor:
    """Of the camera, frame by frame [px]: a quarter of the clips, 0.1 to 0.6 % of the width (`DegradationConfig`)."""
    size = 10 ** _uniform(generator, count, -3.0, -2.2, device) * side
    shaken = torch.rand(count, generator=generator, device=device) < 0.25
    return (size * shaken)[:, None, None] * torch.randn(count, frames, 2, generator=generator, device=device)


def _looks(count: int, azimuth: Tensor, generator: torch.Generator, device: torch.device) -> Float[Tensor, "B 40"]:
    """Colours of body and background, light, and waves of the texture, see gpu/draw.h."""
    rand = torch.rand(count, LOOK, generator=generator, device=device)
    looks = torch.zeros(count, LOOK, device=device)
    looks[:, :6] = 30 + 200 * rand[:, :6]
    side = azimuth + torch.pi + (2 * rand[:, 6] - 1) * 1.3
    height = 0.6 + 0.8 * rand[:, 7]
    looks[:, 6], looks[:, 7] = side.sin() * height.cos(), side.cos() * height.cos()
    looks[:, 8], looks[:, 9] = height.sin(), 0.3 + 0.5 * rand[:, 8]
    strength = 70 * rand[:, 9:10] ** 2
    for wave in range(4):
        direction = torch.randn(count, 3, generator=generator, device=device)
        rate = 3 * 10 ** (rand[:, 10 + wave, None])
        looks[:, 10 + 7 * wave : 13 + 7 * wave] = direction * rate
        looks[:, 13 + 7 * wave] = 2 * torch.pi * rand[:, 14 + wave]
        looks[:, 14 + 7 * wave : 17 + 7 * wave] = strength * torch.randn(count, 3, generator=generator, device=device)
    return looks


def _found(cover: Float[Tensor, "B T S S"], generator: torch.Generator) -> Float[Tensor, "B T S S"]:
    """Silhouettes with an outline error of up to a pixel or two, partly the same in all frames of a clip."""
    count, frames, side = cover.shape[:3]
    device = cover.device
    soft = functional.avg_pool2d(cover.flatten(0, 1)[:, None], 3, stride=1, padding=1).view_as(cover)
    soft = 0.5 * soft + 0.5 * cover

    def waves(number: int, cells: int) -> Tensor:
        coarse = torch.randn(number, 1, cells, cells, generator=generator, device=device)
        return functional.interpolate(coarse, size=(side, side), mode="bilinear", align_corners=False)[:, 0]

    level = 0.25 * _uniform(generator, count, 0.0, 1.0, device)
    lasting = waves(count, 12)[:, None]
    passing = waves(count * frames, 12).view(count, frames, side, side)
    wander = torch.randn(count, frames, generator=generator, device=device)[:, :, None, None]
    bias = torch.randn(count, generator=generator, device=device)[:, None, None, None]
    noise = level[:, None, None, None] * (0.6 * lasting + 0.6 * passing + 0.3 * wander + 0.5 * bias)
    return (soft > 0.5 + noise.clamp(-0.4, 0.4)).float()
