"""A convex field in coordinates without bounds, for optimisers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.convex.field import ConvexField


@dataclass(frozen=True, eq=False)
class FreeParameters:
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
        values = (
            field.points,
            field.smoothness.log(),
            field.sharpness.log(),
            field.opacity.logit(),
            field.harmonics,
        )
        return cls(*(value.detach().clone().requires_grad_() for value in values))

    def field(self) -> ConvexField:
        """The field, differentiable with respect to the parameters."""
        return ConvexField(
            self.points,
            self.log_smoothness.exp(),
            self.log_sharpness.exp(),
            torch.sigmoid(self.logit_opacity),
            self.harmonics,
        )

    def tensors(self) -> tuple[Tensor, ...]:
        """All parameters, in the order of their declaration."""
        return tuple(getattr(self, entry.name) for entry in fields(self))
