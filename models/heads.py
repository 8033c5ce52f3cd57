"""Densities over equal bins: bounded, with exact moments, quantiles and proper scores."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from timm.layers import Mlp
from torch import Tensor, nn

from models.config import BinConfig


@dataclass(frozen=True, eq=False)
class BinnedDensity:
    """Piecewise constant densities on one set of bins, one per clip; the CDF is piecewise linear."""

    edges: Float[Tensor, " K1"]
    probabilities: Float[Tensor, "B K"]

    @classmethod
    def from_logits(cls, logits: Float[Tensor, "B K"], config: BinConfig, *, temperature: float = 1.0) -> BinnedDensity:
        """Softmax of the logits over the temperature."""
        edges = torch.linspace(config.low, config.high, config.bins + 1, device=logits.device)
        return cls(edges=edges, probabilities=(logits.float() / temperature).softmax(dim=-1))

    @property
    def width(self) -> Float[Tensor, ""]:
        """Width of a bin."""
        return (self.edges[-1] - self.edges[0]) / self.probabilities.shape[-1]

    @property
    def centres(self) -> Float[Tensor, " K"]:
        """Middles of the bins."""
        return (self.edges[1:] + self.edges[:-1]) / 2

    def mean(self) -> Float[Tensor, " B"]:
        """Expectations."""
        return self.probabilities @ self.centres

    def std(self) -> Float[Tensor, " B"]:
        """Standard deviations; that of one bin, width/√12, is the least."""
        spread = (self.centres - self.mean()[:, None]).square()
        return ((self.probabilities * spread).sum(dim=-1) + self.width**2 / 12).sqrt()

    def cdf(self, values: Float[Tensor, " B"]) -> Float[Tensor, " B"]:
        """Probability below one value per clip."""
        filled = ((values[:, None] - self.edges[:-1]) / self.width).clamp(0, 1)
        return (self.probabilities * filled).sum(dim=-1).clamp(0, 1)

    def quantile(self, level: float) -> Float[Tensor, " B"]:
        """Where the CDF reaches `level` (0..1)."""
        if not 0 <= level <= 1:
            raise ValueError(f"level: got {level}, expected 0..1")
        cumulative = self.probabilities.cumsum(dim=-1)
        wanted = level * cumulative[:, -1:]
        place = torch.searchsorted(cumulative, wanted).clamp(max=cumulative.shape[-1] - 1)
        inside = self.probabilities.gather(1, place)
        below = cumulative.gather(1, place) - inside
        share = ((wanted - below) / inside.clamp(min=1e-30)).clamp(0, 1)
        return (self.edges[place] + share * self.width)[:, 0]

    def crps(self, values: Float[Tensor, " B"]) -> Float[Tensor, " B"]:
        """Continuous ranked probability score ∫ (F(z) − 1[z ≥ value])² dz, exact (Gneiting, Raftery 2007)."""
        upper = self.probabilities.cumsum(dim=-1)
        lower = upper - self.probabilities
        left = (values[:, None] - self.edges[:-1]).clamp(min=torch.zeros_like(self.width), max=self.width)
        middle = lower + self.probabilities * left / self.width
        before = left * (lower**2 + lower * middle + middle**2) / 3
        high, low = 1 - middle, 1 - upper
        after = (self.width - left) * (high**2 + high * low + low**2) / 3
        return (before + after).sum(dim=-1)


class DensityHead(nn.Module):
    """MLP from the clip's latent to the logits of a `BinnedDensity`."""

    def __init__(self, latent_size: int, config: BinConfig, *, dropout: float) -> None:
        super().__init__()
        self.config = config
        self.mlp = Mlp(latent_size, hidden_features=latent_size, out_features=config.bins, drop=dropout)
        nn.init.normal_(self.mlp.fc2.weight, std=1e-3)

    def forward(self, latent: Float[Tensor, "B D"]) -> Float[Tensor, "B K"]:
        """Logits; nearly flat before training."""
        return self.mlp(latent)
