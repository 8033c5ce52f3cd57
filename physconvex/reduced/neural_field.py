"""Data-free neural skinning weights: a network W(X) trained on the body alone, without simulations.

The network minimises (paper, eq. 4, after Modi et al. 2024, "Simplicits", eqs. 9–11)

    E_Z [ (1/V) ∫ Ψ(F_Z) dV ] + c ‖ (1/V) ∫ [1, W] [1, W]ᵀ dV − I ‖²,       F_Z = ∂/∂X Σ_m W_m(X) Z_m [X; 1] + I,

over random handle transforms Z: weights that deform the body with little energy and are orthonormal to each other and
to the constant weight. Lengths are in units of the body's size and moduli in units of the mean modulus, so that the
options suit every body; a stiff part moves as one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials import checked_constant, get_law, lame_parameters
from physconvex.reduced.basis import check_count
from physconvex.reduced.cubature import BodySamples
from physconvex.reduced.neural_weights import Layers, NeuralWeights, values_and_gradients

PerCell = float | Float[np.ndarray, " C"]


@dataclass(frozen=True)
class NeuralFieldOptions:
    """Shape of the network and its training.

    Attributes:
        hidden_size: width of the hidden layers.
        hidden_layers: their number.
        steps: of Adam, its rate falling to zero along a cosine.
        points: cubature points drawn for each step.
        transforms: random handle transforms drawn for each step.
        learning_rate: Adam's first rate.
        transform_scale: standard deviation of the entries of Z, lengths in units of the body's size.
        orthogonality: c, weight of the orthogonality term.
        law: elastic law; it must be finite for every F.

    Raises:
        InputError: a value out of range.
    """

    hidden_size: int = 64
    hidden_layers: int = 3
    steps: int = 1000
    points: int = 512
    transforms: int = 8
    learning_rate: float = 3e-3
    transform_scale: float = 0.1
    orthogonality: float = 1000.0
    law: str = "neo_hookean"

    def __post_init__(self) -> None:
        for name in ("hidden_size", "hidden_layers", "points", "transforms"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}: got {getattr(self, name)}; expected at least 1")
        if self.steps < 0:
            raise InputError(f"steps: got {self.steps}; expected at least 0 (which leaves the network untrained)")
        for name in ("learning_rate", "transform_scale", "orthogonality"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name}: got {getattr(self, name)}; expected a finite number > 0")


def _deformation_gradients(values: Tensor, gradients: Tensor, x: Tensor, transforms: Tensor) -> Tensor:
    """F = I + Σ_m W_m A_m + (A_m x + t_m) ⊗ ∂W_m/∂x for Z = [A t] of shape [B, M, 3, 4]; shape [B, P, 3, 3]."""
    linear, shift = transforms[..., :3], transforms[..., 3]
    blended = torch.einsum("pm,bmij->bpij", values, linear)
    carried = torch.einsum("bmij,pj->bpmi", linear, x) + shift[:, None]
    return torch.eye(3, dtype=x.dtype) + blended + torch.einsum("bpmi,pmj->bpij", carried, gradients)


def _initial_layers(sizes: list[int], generator: torch.Generator) -> Layers:
    """He initialisation; biases spread over the body."""
    return [
        (
            torch.randn(outputs, inputs, dtype=torch.float64, generator=generator) * np.sqrt(2 / inputs),
            torch.rand(outputs, dtype=torch.float64, generator=generator) - 0.5,
        )
        for inputs, outputs in pairwise(sizes)
    ]


class DataFreeEnergy:
    """The loss of eq. 4 on random points and transforms of one body.

    Args:
        samples: of the body.
        youngs_modulus: E [Pa], scalar or per cell [C]; only its ratios matter.
        poisson_ratio: ν [-], scalar or per cell [C].
        options: `points`, `transforms`, `transform_scale`, `orthogonality`, `law`.

    Raises:
        InputError: constants of a wrong shape or range.
    """

    def __init__(
        self,
        samples: BodySamples,
        *,
        youngs_modulus: PerCell = 1.0,
        poisson_ratio: PerCell = 0.4,
        options: NeuralFieldOptions | None = None,
    ) -> None:
        interior, self.options = samples.interior, NeuralFieldOptions() if options is None else options
        self.center = interior.weights @ interior.points / interior.volume
        self.size = samples.size
        self.x = torch.as_tensor((interior.points - self.center) / self.size)
        self.weights = torch.as_tensor(interior.weights)
        cells = (interior.cell_count,)
        modulus = checked_constant("youngs_modulus", youngs_modulus, cells)[interior.cells]
        ratio = checked_constant("poisson_ratio", poisson_ratio, cells)[interior.cells]
        mean = interior.weights @ modulus / interior.volume
        self.mu, self.lam = lame_parameters(torch.as_tensor(modulus / mean), torch.as_tensor(ratio))
        self.law = get_law(self.options.law)

    def __call__(self, weights: NeuralWeights, generator: torch.Generator) -> Float[Tensor, ""]:
        """Elastic energy (unit: mean modulus) and c times the orthogonality term, differentiable by `layers`.

        Raises:
            InputError: the weights belong to a body of another place or size.
        """
        moved = np.abs(np.append(weights.center - self.center, weights.size - self.size)).max()
        if moved > 1e-6 * self.size:
            raise InputError(
                f"weights: their origin and size are {weights.center} and {weights.size:.6g} m; expected those of the "
                f"body, {self.center} and {self.size:.6g} m"
            )
        elastic, orthogonality = self.terms(weights.layers, generator)
        return elastic + self.options.orthogonality * orthogonality

    def terms(self, layers: Layers, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Elastic and orthogonality term of one step."""
        o, count = self.options, len(layers[-1][1])
        rows = torch.multinomial(self.weights, o.points, replacement=True, generator=generator)
        x = self.x[rows]
        values, gradients = values_and_gradients(layers, x)
        transforms = o.transform_scale * torch.randn(
            o.transforms, count, 3, 4, dtype=torch.float64, generator=generator
        )
        f = _deformation_gradients(values, gradients, x, transforms)
        # the scale of the transforms is divided out, so that it does not change the balance of the two terms
        elastic = self.law.energy(f, self.mu[rows], self.lam[rows]).mean() / o.transform_scale**2
        together = torch.cat([torch.ones_like(values[:, :1]), values], dim=1)
        gram = together.mT @ together / len(together)
        return elastic, ((gram - torch.eye(count + 1, dtype=torch.float64)) ** 2).sum()

    def train(
        self, layers: Layers, generator: torch.Generator, on_step: Callable[[int], None] | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Adam in place; the two terms at every step."""
        o = self.options
        parameters = [tensor.requires_grad_() for layer in layers for tensor in layer]
        optimiser = torch.optim.Adam(parameters, lr=o.learning_rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, T_max=max(o.steps, 1))
        history = np.zeros((o.steps, 2))
        for step in range(o.steps):
            with torch.enable_grad():
                elastic, orthogonality = self.terms(layers, generator)
                optimiser.zero_grad()
                (elastic + o.orthogonality * orthogonality).backward()
            optimiser.step()
            schedule.step()
            history[step] = elastic.item(), orthogonality.item()
            if on_step is not None:
                on_step(step + 1)
        return history[:, 0], history[:, 1]


def train_neural_weights(
    samples: BodySamples,
    count: int,
    *,
    generator: torch.Generator,
    youngs_modulus: PerCell = 1.0,
    poisson_ratio: PerCell = 0.4,
    options: NeuralFieldOptions | None = None,
    on_step: Callable[[int], None] | None = None,
) -> NeuralWeights:
    """Train skinning weights for one body.

    Args:
        samples: samples of the body; the interior points represent it.
        count: M, number of weights besides the constant one.
        generator: source of everything random, on the CPU.
        youngs_modulus: E [Pa], scalar or per cell [C]; only its ratios matter.
        poisson_ratio: ν [-], scalar or per cell [C].
        options: network and training; the defaults take under a minute on two cores.
        on_step: called with the number of every finished step.

    Raises:
        InputError: `count` is not in 1..64, constants of a wrong shape or range, or the training diverges.
    """
    options = NeuralFieldOptions() if options is None else options
    check_count(count)
    trainer = DataFreeEnergy(samples, youngs_modulus=youngs_modulus, poisson_ratio=poisson_ratio, options=options)
    layers = _initial_layers([3, *[options.hidden_size] * options.hidden_layers, count], generator)
    elastic, orthogonality = trainer.train(layers, generator, on_step)
    if not all(bool(torch.isfinite(tensor).all()) for layer in layers for tensor in layer):
        raise InputError(f"options: the training ran off with learning_rate {options.learning_rate}; give a lower one")
    frozen = tuple((weight.detach(), bias.detach()) for weight, bias in layers)
    return NeuralWeights(frozen, trainer.center, trainer.size, elastic, orthogonality)


def untrained_neural_weights(
    samples: BodySamples, count: int, *, generator: torch.Generator, options: NeuralFieldOptions | None = None
) -> NeuralWeights:
    """The network before training: random smooth weights, the reference for a trained field."""
    options = NeuralFieldOptions() if options is None else options
    bare = NeuralFieldOptions(hidden_size=options.hidden_size, hidden_layers=options.hidden_layers, steps=0)
    return train_neural_weights(samples, count, generator=generator, options=bare)
