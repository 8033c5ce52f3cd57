"""The convex field: an object as a set of coloured, soft-edged convex hulls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.convex.spherical_harmonics import degree_of
from physconvex.errors import InputError

LEAST_POINTS = 4  # fewer enclose no volume


@dataclass(frozen=True, eq=False)
class ConvexField:
    """N convexes, each the hull of K ≥ 4 points, in the world frame.

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
        InputError: shapes that do not fit, fewer than four points, unequal types or devices.
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

    def tensors(self) -> tuple[Tensor, ...]:
        """All attributes, in the order of their declaration."""
        return tuple(getattr(self, entry.name) for entry in fields(self))

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return degree_of(self.harmonics.shape[1])

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
