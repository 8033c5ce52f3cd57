"""A reduced roll-out as a differentiable torch function, of named parameters or of the skinning weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from physconvex.dynamics import Timing, simulate, simulate_with_sensitivities
from physconvex.errors import InputError
from physconvex.numerics import one_torch_thread
from physconvex.reduced.adjoint import RecordedRollOut, Sweep
from physconvex.reduced.basis import CallableWeights, checked_points, weight_slopes
from physconvex.reduced.field_gradient import FieldBars
from physconvex.reduced.parameters import with_parameters
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.sensitivity import NamedParameters
from physconvex.reduced.space import ReducedSpace


class _RollOut(torch.autograd.Function):
    """Positions of material points as a function of parameter values; the forward pass computes the Jacobian."""

    @staticmethod
    def forward(
        ctx: Any,
        values: Tensor,
        parametrised: NamedParameters,
        points: np.ndarray,
        timing: Timing | None,
    ) -> Tensor:
        names = parametrised.names
        at = with_parameters(parametrised.scene, names, values.detach().double().cpu().numpy())
        if not ctx.needs_input_grad[0]:
            return torch.as_tensor(simulate(at, timing).positions(points)).to(values)
        run = simulate_with_sensitivities(NamedParameters(at, names), timing)
        ctx.save_for_backward(torch.as_tensor(run.trajectory.carried(points, run.coordinate_tangents)).to(values))
        return torch.as_tensor(run.trajectory.positions(points)).to(values)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        (jacobian,) = ctx.saved_tensors
        return torch.einsum("tpni,tni->p", jacobian, gradient), None, None, None


def rollout_positions(
    values: Float[Tensor, " P"],
    *,
    scene: ReducedScene,
    parameters: Sequence[str],
    points: Float[np.ndarray, "n 3"],
    timing: Timing | None = None,
) -> Float[Tensor, "T n 3"]:
    """Positions [m] of material points at the frames, differentiable once with respect to the parameter values.

    Args:
        values: values of the parameters, float64 for full accuracy.
        scene: provides everything that is not in `parameters`.
        parameters: names, see `physconvex.reduced.PARAMETERS`.
        points: rest positions [m].
        timing: as in `simulate`.

    Raises:
        InputError: shapes that do not fit, unknown names, values out of range.
        ConvergenceError: a time step failed.
    """
    if values.shape != (len(parameters),):
        raise InputError(f"values: got shape {tuple(values.shape)}; expected ({len(parameters)},), one per parameter")
    return _RollOut.apply(
        values, NamedParameters(scene, tuple(parameters)), np.asarray(points, dtype=np.float64), timing
    )


class _WeightsRollOut(torch.autograd.Function):
    """Positions of material points as a function of the weights at all sample points of a body.

    These are: interior samples (at which `slopes` are given), surface samples, the points that integrate the mass,
    pins, points of loads, and the material points.
    """

    @staticmethod
    def forward(ctx: Any, values: Tensor, slopes: Tensor, recorded: RecordedRollOut, points: np.ndarray) -> Tensor:
        ctx.recorded, ctx.points, ctx.like = recorded, points, values.detach()[:0]
        return torch.as_tensor(recorded.trajectory.positions(points)).to(values)

    @staticmethod
    @once_differentiable
    @one_torch_thread()
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, None, None]:
        trajectory, by_position = ctx.recorded.trajectory, gradient.detach().double().cpu().numpy()
        field = FieldBars(ctx.recorded.scene)
        sweep = Sweep(ctx.recorded.scene, (), field)
        ctx.recorded.swept(sweep, trajectory.space.shape_values(ctx.points).T @ by_position)
        seen = np.einsum("tni,tri->nr", by_position, trajectory.coordinates)
        values, slopes = field.finish(sweep.products)
        values = np.concatenate([values, trajectory.space.weights_of_values(ctx.points, seen)])
        return torch.as_tensor(values).to(ctx.like), torch.as_tensor(slopes).to(ctx.like), None, None


def rollout_of_weights(
    function: Callable[[Float[Tensor, "P 3"]], Float[Tensor, "P M"]],
    count: int,
    *,
    scene: ReducedScene,
    points: Float[np.ndarray, "n 3"],
    timing: Timing | None = None,
) -> Float[Tensor, "T n 3"]:
    """Positions [m] of material points at the frames, differentiable once by the parameters of the weights.

    The weights W^θ(X) of `function` move the body of the scene. The derivatives by θ come from the adjoint of the
    roll-out, one backward sweep for all of them (`physconvex.reduced.field_gradient`).

    Args:
        function: float64 rest positions [m] → weights, each row a function of its own point alone, twice differentiable
            by torch; usually a network with parameters θ.
        count: M.
        scene: everything but the weights; its body is elastic or damped, and starts in its rest shape.
        points: rest positions [m].
        timing: as in `simulate`; the error of the derivatives is that of Newton's `tolerance`.

    Raises:
        InputError: shapes that do not fit, a body that flows, coordinates given for the start.
        ConvergenceError: a time step failed.
    """
    if scene.initial_coordinates is not None:
        raise InputError(
            "scene: got initial_coordinates, which belong to its own weights; leave them out (the body then starts at "
            "rest shape, placed by initial_orientation)"
        )
    points, samples = checked_points(points), scene.body.space.samples
    body = scene.body.with_space(ReducedSpace(CallableWeights(function, count), samples))
    recorded = RecordedRollOut(replace(scene, body=body), timing)
    none = np.zeros((0, 3))
    pins = none if scene.pins is None else scene.pins.points
    loads = none if scene.loads is None else scene.loads.points
    interior = torch.tensor(samples.interior.points, dtype=torch.float64, requires_grad=True)
    inside = function(interior)
    slopes = weight_slopes(inside, interior, differentiable=True)
    others = np.concatenate([samples.surface_points, samples.mass.points, pins, loads, points])
    values = torch.cat([inside, function(torch.tensor(others, dtype=torch.float64))])
    return _WeightsRollOut.apply(values, slopes, recorded, points)
