"""The convex field: an object as a set of coloured, soft-edged convex hulls; its coordinates for optimisers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.convex.spherical_harmonics import degree_of
from physconvex.errors import InputError

LEAST_POINTS = 3  # of a flat convex, a triangle


class _Tensors:
    def tensors(self) -> tuple[Tensor, ...]:
        """All attributes, in the order of their declaration."""
        return tuple(vars(self).values())


@dataclass(frozen=True, eq=False)
class ConvexField(_Tensors):
    """N convexes, each the hull of K ≥ 3 points, in the world frame; with three they are flat.

    Occupancy of one convex (3D Convex Splatting, Held et al. 2025), in space with signed distances f_h [m] to the faces
    of its hull, in an image with those to the edges of its projected hull at the depth of its centre:
    O = sigmoid(−β log Σ_h exp(α f_h)). Far from corners an edge is a sigmoid of slope αβ/4 [1/m].

    With K = 6 and spherical harmonics of degree 3 a convex has 69 parameters.

    Attributes:
        points: the points whose hull the convex is, shape [N, K, 3], metres, world frame.
        smoothness: α > 0, how sharp corners are, shape [N], 1/m.
        sharpness: β > 0, how sharp edges are at a given α, shape [N], dimensionless.
        opacity: opacity inside, 0 to 1, shape [N].
        harmonics: spherical-harmonics coefficients of red, green and blue, shape [N, (degree + 1)², 3], see
            `spherical_harmonics`.

    Raises:
        InputError: shapes that do not fit, fewer than three points, unequal types or devices.
    """

    points: Float[Tensor, "N K 3"]
    smoothness: Float[Tensor, " N"]
    sharpness: Float[Tensor, " N"]
    opacity: Float[Tensor, " N"]
    harmonics: Float[Tensor, "N S 3"]

    def __post_init__(self) -> None:
        if self.points.ndim != 3 or self.points.shape[2] != 3 or self.points.shape[1] < LEAST_POINTS:
            raise InputError(
                f"points: got shape {tuple(self.points.shape)}; expected [N, K, 3] with K ≥ {LEAST_POINTS}"
            )
        count = len(self.points)
        for name in ("smoothness", "sharpness", "opacity"):
            if getattr(self, name).shape != (count,):
                got = tuple(getattr(self, name).shape)
                raise InputError(f"{name}: got shape {got}; expected [{count}], one per convex")
        if self.harmonics.ndim != 3 or self.harmonics.shape[::2] != (count, 3):
            raise InputError(f"harmonics: got shape {tuple(self.harmonics.shape)}; expected [{count}, S, 3]")
        degree_of(self.harmonics.shape[1])
        kinds = {(tensor.dtype, tensor.device) for tensor in self.tensors()}
        if len(kinds) > 1 or not self.points.is_floating_point():
            raise InputError(f"convex field: got types and devices {kinds}; expected one floating type on one device")

    @classmethod
    def joined(cls, fields: Sequence[ConvexField]) -> ConvexField:
        """The convexes of several fields, one field after the other; all with as many points and harmonics."""
        return cls(*(torch.cat(parts) for parts in zip(*(one.tensors() for one in fields), strict=True)))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def centres(self) -> Float[Tensor, "N 3"]:
        """Mean of the points of each convex [m]."""
        return self.points.mean(dim=1)

    @property
    def parameters_per_convex(self) -> int:
        """Numbers that describe one convex."""
        return sum(tensor[:1].numel() for tensor in self.tensors())

    def map(self, function: Callable[[Tensor], Tensor]) -> ConvexField:
        """The field of `function(attribute)`."""
        return ConvexField(*map(function, self.tensors()))

    def to(self, target: torch.dtype | torch.device | str) -> ConvexField:
        """The field in another floating type or on another device."""
        return self.map(lambda tensor: tensor.to(target))

    def select(self, convexes: Int[Tensor, " M"] | Tensor) -> ConvexField:
        """Those convexes, by indices or by a mask."""
        return self.map(lambda tensor: tensor[convexes])

    def with_points(self, points: Float[Tensor, "N K 3"]) -> ConvexField:
        """The same convexes with other points [m]."""
        return replace(self, points=points)

    def check_values(self) -> None:
        """Check that values are in range.

        Raises:
            InputError: numbers that are not finite, α or β not positive, opacity outside 0 to 1.
        """
        for entry in fields(self):
            if not getattr(self, entry.name).isfinite().all():
                raise InputError(f"{entry.name}: holds numbers that are not finite")
        for name in ("smoothness", "sharpness"):
            if (getattr(self, name) <= 0).any():
                raise InputError(f"{name}: got {float(getattr(self, name).min())}; expected positive numbers")
        if (self.opacity < 0).any() or (self.opacity > 1).any():
            raise InputError("opacity: expected numbers from 0 to 1")


@dataclass(frozen=True, eq=False)
class FreeParameters(_Tensors):
    """The attributes of a `ConvexField`, the bounded ones transformed so that any real number is valid.

    Attributes:
        points: as they are [m].
        log_smoothness: natural logarithm of α [1/m].
        log_sharpness: natural logarithm of β.
        logit_opacity: log(σ / (1 − σ)) of the opacity σ.
        harmonics: as they are.
    """

    points: Float[Tensor, "N K 3"]
    log_smoothness: Float[Tensor, " N"]
    log_sharpness: Float[Tensor, " N"]
    logit_opacity: Float[Tensor, " N"]
    harmonics: Float[Tensor, "N S 3"]

    @classmethod
    def of(cls, field: ConvexField) -> FreeParameters:
        """Leaves of a new graph at a field's values; an opacity of exactly 0 or 1 has no finite coordinate."""
        edges = field.smoothness.log(), field.sharpness.log()
        values = (field.points, *edges, field.opacity.logit(), field.harmonics)
        return cls(*(value.detach().clone().requires_grad_() for value in values))

    def field(self) -> ConvexField:
        """The field, differentiable with respect to the parameters."""
        edges = self.log_smoothness.exp(), self.log_sharpness.exp()
        return ConvexField(self.points, *edges, torch.sigmoid(self.logit_opacity), self.harmonics)


def numbers(tensor: Tensor) -> np.ndarray:
    """A tensor as a float64 array, without its graph."""
    return tensor.detach().cpu().double().numpy()
