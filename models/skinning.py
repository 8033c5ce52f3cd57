"""The skinning head, whose result is a field of weights W(X) that is independent of the network."""

from __future__ import annotations

from itertools import pairwise

from jaxtyping import Float
from torch import Tensor, nn

from models.config import SkinningConfig
from physconvex.reduced import SkinningField, fourier_network


class SkinningHead(nn.Module):
    """MLP over Fourier features whose layers are scaled and shifted by the clip's latent (FiLM).

    Scale and shift are folded into the layers, so that one clip's field is a plain MLP: `layers_of`.
    """

    def __init__(self, latent_size: int, config: SkinningConfig) -> None:
        super().__init__()
        self.config = config
        sizes = [3 + 6 * config.harmonics, *[config.hidden_size] * config.layers, config.handles]
        layers = [nn.Linear(inputs, outputs) for inputs, outputs in pairwise(sizes)]
        self.layers = nn.ModuleList(layers)
        self.modulation = nn.Linear(latent_size, 2 * config.hidden_size * config.layers)
        nn.init.normal_(self.modulation.weight, std=0.02)
        nn.init.zeros_(self.modulation.bias)

    def layers_of(self, latent: Float[Tensor, "B D"]) -> list[tuple[Float[Tensor, "B O I"], Float[Tensor, "B 1 O"]]]:
        """Weights and biases of each clip's own MLP."""
        scale, shift = self.modulation(latent).unflatten(1, (2, self.config.layers, -1)).unbind(dim=1)
        folded = []
        for k, layer in enumerate(self.layers):
            weight, bias = layer.get_parameter("weight")[None], layer.get_parameter("bias")[None]
            if k < self.config.layers:
                weight, bias = weight * (1 + scale[:, k, :, None]), bias * (1 + scale[:, k]) + shift[:, k]
            count = len(latent)
            folded.append((weight.expand(count, -1, -1), bias.expand(count, -1)[:, None]))
        return folded

    def forward(self, latent: Float[Tensor, "B D"], points: Float[Tensor, "B Q 3"]) -> Float[Tensor, "B Q M"]:
        """Weights of the handles at points in units of the object size, in the object frame."""
        return fourier_network(self.layers_of(latent), points, self.config.harmonics)

    def fields(self, latent: Float[Tensor, "B D"], object_sizes: list[float]) -> list[SkinningField]:
        """The frozen fields of a batch of clips; sizes in metres."""
        layers = [(w.detach().cpu().float(), b.detach().cpu().float()) for w, b in self.layers_of(latent)]
        found = []
        for clip, size in enumerate(object_sizes):
            tensors = {}
            for k, (weight, bias) in enumerate(layers):
                tensors[f"weight_{k}"] = weight[clip].numpy().copy()
                tensors[f"bias_{k}"] = bias[clip, 0].numpy().copy()
            found.append(SkinningField(tensors=tensors, object_size=size, harmonics=self.config.harmonics))
        return found
