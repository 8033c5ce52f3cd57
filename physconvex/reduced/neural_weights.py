"""Skinning weights as a small network W^θ(X) of the rest position, with exact gradients; in float64."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

Layers = Sequence[tuple[Tensor, Tensor]]


@dataclass(frozen=True, eq=False)
class NeuralWeights:
    """Skinning weights given by a small network, C^∞, in float64; a `WeightField`.

    Attributes:
        layers: weight matrices [O, I] and biases [O] of the network, SiLU between them.
        center: rest position of the network's origin [m], shape [3].
        size: length unit of the network [m].
        elastic_history: mean elastic term of each training step (unit: mean modulus), shape [T].
        orthogonality_history: orthogonality term ‖·‖² of each training step, shape [T].
    """

    layers: tuple[tuple[Tensor, Tensor], ...] = field(repr=False)
    center: Float[np.ndarray, " 3"]
    size: float
    elastic_history: Float[np.ndarray, " T"] = field(repr=False)
    orthogonality_history: Float[np.ndarray, " T"] = field(repr=False)

    @property
    def count(self) -> int:
        """M, the number of weights besides the constant one."""
        return len(self.layers[-1][1])

    def __call__(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "P M"]:
        """Values [-] at rest positions [m], differentiable by torch, also by `layers` that require gradients."""
        values = (points - torch.as_tensor(self.center)) / self.size
        for number, (weight, bias) in enumerate(self.layers):
            values = (values if number == 0 else torch.nn.functional.silu(values)) @ weight.mT + bias
        return values

    def with_slopes(self, points: Float[Tensor, "P 3"]) -> tuple[Float[Tensor, "P M"], Float[Tensor, "P M 3"]]:
        """Values [-] and exact gradients [1/m] at rest positions [m], differentiable by torch."""
        x = (points - torch.as_tensor(self.center)) / self.size
        values, gradients = values_and_gradients(self.layers, x)
        return values, gradients / self.size

    @property
    def theta(self) -> Float[Tensor, " N"]:
        """All parameters θ, one layer after the other."""
        return torch.cat([part.flatten() for layer in self.layers for part in layer])

    def with_theta(self, theta: Float[Tensor, " N"]) -> NeuralWeights:
        """The same network with other parameters, differentiable by them."""
        shapes = [part.shape for layer in self.layers for part in layer]
        pieces = theta.split([shape.numel() for shape in shapes])
        parts = [piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True)]
        return replace(self, layers=tuple(zip(parts[::2], parts[1::2], strict=True)))

    def at(self, points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "P M 3"]]:
        """Values [-] and exact gradients [1/m] at rest positions [m]."""
        with torch.no_grad():
            values, gradients = self.with_slopes(torch.as_tensor(np.asarray(points, dtype=np.float64)))
        return values.numpy(), gradients.numpy()


def values_and_gradients(layers: Layers, x: Tensor) -> tuple[Tensor, Tensor]:
    """W [P, M] and ∂W/∂x [P, M, 3] by the chain rule carried forward: SiLU'(a) = s (1 + a (1 − s)), s = sigmoid(a)."""
    values, slopes = x, torch.eye(3, dtype=x.dtype).expand(len(x), 3, 3)  # slopes: [P, axis, feature]
    for number, (weight, bias) in enumerate(layers):
        values, slopes = values @ weight.mT + bias, slopes @ weight.mT
        if number < len(layers) - 1:
            s = torch.sigmoid(values)
            slopes = slopes * (s * (1 + values * (1 - s)))[:, None]
            values = values * s
    return values, slopes.mT
