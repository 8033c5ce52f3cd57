"""Relation of pixels and single convexes: their weights in views, and any image summed with those weights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.render import View, splat


@dataclass(frozen=True, eq=False)
class Gathered:
    """Sums over the pixels p of one or more views, w_ip being the weight of convex i in pixel p.

    Attributes:
        weights: Σ_p w_ip, shape [N]: how many pixels a convex explains.
        values: Σ_p w_ip v_p of the given three-channel images v, shape [N, 3].
    """

    weights: Float[Tensor, " N"]
    values: Float[Tensor, "N 3"]

    def means(self, fallback: Float[Tensor, " 3"]) -> Float[Tensor, "N 3"]:
        """Weighted mean of v over the pixels of each convex; `fallback` for those that explain hardly any pixel."""
        seen = self.weights > 1e-3
        return torch.where(seen[:, None], self.values / torch.where(seen, self.weights, 1.0)[:, None], fallback)


def gather(field: ConvexField, view: View, image: Float[Tensor, "H W 3"]) -> Gathered:
    """Gather an image of a view.

    Rendering is linear in the blended features, so its transpose applied to the image (one backward pass with the image
    as the gradient) gives exactly the sums.
    """
    with torch.no_grad():
        splats, composite = splat(field, view)
    features = splats.features.detach().requires_grad_()
    layers = composite(replace(splats, features=features), view.pixel_coordinates())
    ones = torch.ones_like(image[..., :1])
    (sums,) = torch.autograd.grad(layers.features, features, torch.cat([image, ones], dim=-1))
    found = sums.new_zeros((len(field), 4)).index_add_(0, splats.convex, sums)
    return Gathered(found[:, 3], found[:, :3])
