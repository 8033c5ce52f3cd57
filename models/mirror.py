"""A clip and its mirror image have the same motion: the estimates of both are averaged."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from models.network import ClipBatch, NetworkOutput, PhysicsNetwork
from models.silhouette import MOMENT_NAMES

_Moments = TypeVar("_Moments", Float[np.ndarray, "*T M"], Float[Tensor, "*T M"])

_SWAPPED = {"left": "right", "right": "left"}
_SOURCE = np.array([MOMENT_NAMES.index(_SWAPPED.get(name, name)) for name in MOMENT_NAMES])
_SIGN = np.array([-1.0 if name in ("centroid_x", "left", "right", "sxy") else 1.0 for name in MOMENT_NAMES], np.float32)


def mirrored_moments(moments: _Moments) -> _Moments:
    """Moments of the mirrored silhouettes: x changes its sign."""
    sign = torch.from_numpy(_SIGN).to(moments.device) if isinstance(moments, Tensor) else _SIGN
    return moments[..., _SOURCE] * sign


def mirrored_batch(batch: ClipBatch) -> ClipBatch:
    """Left and right exchanged."""
    return replace(batch, windows=batch.windows.flip(3), moments=mirrored_moments(batch.moments))


def answer_both_ways(
    network: PhysicsNetwork, batch: ClipBatch, points: Float[Tensor, "B Q 3"] | None = None
) -> NetworkOutput:
    """Output of the network for the clips, with both densities averaged over clip and mirror image.

    States, latent and skinning weights are those of the clips as they are. Arguments as of `PhysicsNetwork.forward`.
    """
    seen = network(batch, points)
    turned = network(mirrored_batch(batch))
    return replace(
        seen,
        stiffness_logits=_mean_density(seen.stiffness_logits, turned.stiffness_logits),
        poisson_logits=_mean_density(seen.poisson_logits, turned.poisson_logits),
    )


def _mean_density(one: Float[Tensor, "B K"], other: Float[Tensor, "B K"]) -> Float[Tensor, "B K"]:
    """Logits of the mean of two densities."""
    both = torch.stack([one.float().log_softmax(dim=-1), other.float().log_softmax(dim=-1)])
    return both.logsumexp(dim=0) - float(np.log(2.0))
