"""VideoMAE encoder: public weights at any size, without the empty tokens."""

from __future__ import annotations

import math
from pathlib import Path

import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional
from transformers import VideoMAEConfig, VideoMAEModel
from transformers.models.videomae.modeling_videomae import get_sinusoid_encoding_table

from models.config import EncoderConfig
from physconvex import InputError

Grid = tuple[int, int, int]

_MEAN = (0.485, 0.456, 0.406, 0.5)
_STD = (0.229, 0.224, 0.225, 0.5)


def normalised(windows: UInt8[Tensor, "B T W W 4"]) -> Float[Tensor, "B T 4 W W"]:
    """Windows as the networks' input: colours in the scale of the public VideoMAE weights, coverage from −1 to 1."""
    mean, std = (torch.tensor(v, device=windows.device).mul_(255).view(-1, 1, 1) for v in (_MEAN, _STD))
    return windows.movedim(-1, 2).to(torch.float32, memory_format=torch.contiguous_format).sub_(mean).div_(std)


class VideoEncoder(nn.Module):
    """Windows that follow the object -> tokens with their place in the clip."""

    tie_break: Tensor

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.config = config
        self.model = VideoMAEModel(_videomae_config(config))
        self.model.set_attn_implementation("eager")  # on a processor faster than the fused kernel at these lengths
        self.model.embeddings.position_embeddings = position_table(config)
        noise = torch.rand(config.tokens, generator=torch.Generator().manual_seed(0))
        self.register_buffer("tie_break", noise, persistent=False)

    def forward(
        self,
        pictures: Float[Tensor, "B T 4 W W"],
        *,
        generator: torch.Generator | None = None,
    ) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "B N"], Int64[Tensor, "B N"]]:
        """Tokens kept of `normalised` pictures, each one's coverage by the object (0..1), its number in the clip.

        In training, `train_keep` of the tokens, those that show the object first and at random (by
        `generator`, CPU); otherwise the `eval_keep` best covered.
        """
        coverage = token_coverage(pictures[:, :, 3], self.config)
        if self.training:
            noise = torch.rand(coverage.shape, generator=generator).to(coverage.device)
            score, share = (coverage > 0).float() + noise, self.config.train_keep
        else:
            score, share = coverage + 1e-3 * self.tie_break, self.config.eval_keep
        keep = max(1, round(share * self.config.tokens))
        place = score.topk(keep, dim=1).indices.sort(dim=1).values
        hidden = torch.ones_like(coverage, dtype=torch.bool).scatter_(1, place, False)
        tokens = self.model(pictures[:, :, : self.config.channels], bool_masked_pos=hidden).last_hidden_state
        return tokens, coverage.gather(1, place), place


def token_coverage(cover: Float[Tensor, "B T W W"], config: EncoderConfig) -> Float[Tensor, "B N"]:
    """Share of each tubelet that the object covers, 0..1, in the order of the tokens; `cover` is −1..1."""
    size = (config.tubelet, config.patch_size, config.patch_size)
    return (functional.avg_pool3d(cover[:, None], size).flatten(1) + 1) / 2


def position_table(config: EncoderConfig) -> Float[Tensor, "1 N D"]:
    """Fixed position embeddings.

    Without `position_grid` sines and cosines of time, row and column, a third of the channels each. With it
    the table of VideoMAE (sinusoids of the running token number) on that grid, interpolated linearly in time
    and space, which is the identity if the grids agree.
    """
    if config.position_grid is None:
        return _separable_table(config.grid, config.hidden_size)
    source = get_sinusoid_encoding_table(math.prod(config.position_grid), config.hidden_size)
    if config.position_grid == config.grid:
        return source
    volume = source.view(1, *config.position_grid, -1).movedim(-1, 1)
    resized = functional.interpolate(volume, size=config.grid, mode="trilinear", align_corners=False)
    return resized.flatten(2).transpose(1, 2).contiguous()


def _separable_table(grid: Grid, channels: int) -> Float[Tensor, "1 N D"]:
    frequencies = channels // 6
    angles = torch.exp(torch.linspace(0.0, -math.log(100.0), frequencies))
    parts = []
    for axis, length in enumerate(grid):
        phase = torch.arange(length)[:, None] * angles
        waves = torch.cat([phase.sin(), phase.cos()], dim=1)
        shape = [1, 1, 1, 2 * frequencies]
        shape[axis] = length
        parts.append(waves.view(shape).expand(*grid, -1))
    table = torch.cat(parts, dim=-1).reshape(1, math.prod(grid), -1)
    return functional.pad(table, (0, channels - table.shape[-1]))


def _videomae_config(config: EncoderConfig) -> VideoMAEConfig:
    return VideoMAEConfig(
        image_size=config.image_size,
        patch_size=config.patch_size,
        num_channels=config.channels,
        num_frames=config.frames,
        tubelet_size=config.tubelet,
        hidden_size=config.hidden_size,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        intermediate_size=4 * config.hidden_size,
        hidden_dropout_prob=config.dropout,
        attention_probs_dropout_prob=0.0,
        layer_norm_eps=1e-6,
    )


def load_pretrained_encoder(name_or_path: str | Path, config: EncoderConfig) -> VideoEncoder:
    """An encoder with public VideoMAE weights, for another image size, number of frames, tubelet or channels.

    Args:
        name_or_path: a folder, or a name on the model hub such as `MCG-NJU/videomae-base`.
        config: the input wanted; hidden size, layers, heads, patch and position grid come from the weights.

    The patch embedding gets a mask channel that is zero at first. For another tubelet its kernel is averaged over time
    and scaled, so that a still clip gives the same embedding.

    Raises:
        InputError: there are no such weights.
    """
    try:
        source = VideoMAEModel.from_pretrained(name_or_path)
    except (OSError, ValueError) as error:
        raise InputError(
            f"pretrained: no VideoMAE weights at {str(name_or_path)!r} ({error}); give a folder with "
            "config.json and model.safetensors, or train from scratch"
        ) from error
    theirs = source.config
    assert isinstance(theirs.image_size, int) and isinstance(theirs.patch_size, int)
    side = theirs.image_size // theirs.patch_size
    grid = (theirs.num_frames // theirs.tubelet_size, side, side)
    config = config.model_copy(
        update={
            "hidden_size": theirs.hidden_size,
            "layers": theirs.num_hidden_layers,
            "heads": theirs.num_attention_heads,
            "patch_size": theirs.patch_size,
            "position_grid": grid,
        }
    )
    encoder = VideoEncoder(EncoderConfig.model_validate(config.model_dump()))
    state = source.state_dict()
    name = "embeddings.patch_embeddings.projection.weight"
    state[name] = _fit_kernel(state[name], config.channels, config.tubelet)
    missing, unexpected = encoder.model.load_state_dict(state, strict=False)
    if missing or set(unexpected) - {"layernorm.weight", "layernorm.bias"}:
        raise InputError(f"pretrained: weights at {str(name_or_path)!r} lack {missing}, hold {unexpected}")
    return encoder


def _fit_kernel(kernel: Float[Tensor, "D c t p p"], channels: int, tubelet: int) -> Float[Tensor, "D C T p p"]:
    extra = channels - kernel.shape[1]
    if extra > 0:
        kernel = functional.pad(kernel, (0, 0, 0, 0, 0, 0, 0, extra))
    if kernel.shape[2] == tubelet:
        return kernel
    return kernel.mean(dim=2, keepdim=True).expand(-1, -1, tubelet, -1, -1).contiguous() * (kernel.shape[2] / tubelet)
