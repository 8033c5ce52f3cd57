"""A reduced roll-out as a differentiable torch function."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from physconvex.errors import InputError
from physconvex.reduced.parameters import with_parameters
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.sensitivity import simulate_with_sensitivities
from physconvex.reduced.simulation import simulate

__all__ = ["rollout_positions"]


class _RollOut(torch.autograd.Function):
    """Positions of material points as a function of parameter values; the Jacobian is made in the forward pass."""

    @staticmethod
    def forward(
        ctx: Any,
        values: Tensor,
        scene: ReducedScene,
        names: tuple[str, ...],
        points: np.ndarray,
        options: dict[str, Any],
    ) -> Tensor:
        at = with_parameters(scene, names, values.detach().double().cpu().numpy())
        if not ctx.needs_input_grad[0]:
            return torch.as_tensor(simulate(at, **options).positions(points)).to(values)
        run = simulate_with_sensitivities(at, names, **options)
        ctx.save_for_backward(torch.as_tensor(run.position_tangents(points)).to(values))
        return torch.as_tensor(run.trajectory.positions(points)).to(values)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None, None, None]:
        (jacobian,) = ctx.saved_tensors
        return torch.einsum("tpni,tni->p", jacobian, gradient), None, None, None, None


def rollout_positions(
    values: Float[Tensor, " P"],
    *,
    scene: ReducedScene,
    parameters: Sequence[str],
    points: Float[np.ndarray, "n 3"],
    **options: Any,
) -> Float[Tensor, "T n 3"]:
    """Positions [m] of material points at the frames, differentiable once with respect to the parameter values.

    Args:
        values: values of the parameters, float64 for full accuracy.
        scene: everything that is not named in `parameters`.
        parameters: names, see `physconvex.reduced.PARAMETERS`.
        points: rest positions [m].
        options: of `simulate`.

    Raises:
        InputError: shapes that do not fit, unknown names, values out of range.
        ConvergenceError: a time step failed.
    """
    if values.shape != (len(parameters),):
        raise InputError(f"values: got shape {tuple(values.shape)}; expected ({len(parameters)},), one per parameter")
    return _RollOut.apply(values, scene, tuple(parameters), np.asarray(points, dtype=np.float64), options)
