"""Measures of the hulls of a field."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.convex.hull_points import hull_volume


def hull_volumes(field: ConvexField) -> Float[np.ndarray, " N"]:
    """Volume of each hull [m³]."""
    return np.array([hull_volume(points) for points in field.points.detach().cpu().double().numpy()])


def support(field: ConvexField, directions: Float[Tensor, "Q 3"]) -> Float[Tensor, "Q N"]:
    """Support function max_k n · p_k [m] of the hulls in unit directions n."""
    return torch.einsum("qi,nki->qnk", directions, field.points).amax(dim=-1)
