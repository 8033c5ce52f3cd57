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
from physconvex.reduced.basis import CallableWeights, WeightField, checked_points, weight_slopes
from physconvex.reduced.field_gradient import FieldBars
from physconvex.reduced.neural_weights import NeuralWeights
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
    """Positions of material points as a function of the weights at all sample points of a body, and of parameters.

    The sample points are: interior samples (at which `slopes` are given), surface samples, the points that integrate
    the mass, pins, points of loads, and the material points.
    """

    @staticmethod
    def forward(
        ctx: Any,
        weights: Tensor,
        slopes: Tensor,
        values: Tensor,
        recorded: RecordedRollOut,
        of: tuple[np.ndarray, tuple[str, ...]],
    ) -> Tensor:
        ctx.recorded, (ctx.points, ctx.names), ctx.like = recorded, of, weights.detach()[:0]
        own = weights.detach()[len(weights) - len(ctx.points) :].double().cpu().numpy()
        ctx.shapes = recorded.trajectory.space.shape_values_of(ctx.points, own)
        return torch.as_tensor(ctx.shapes @ recorded.trajectory.coordinates).to(weights)

    @staticmethod
    @once_differentiable
    @one_torch_thread()
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor, None, None]:
        trajectory, by_position = ctx.recorded.trajectory, gradient.detach().double().cpu().numpy()
        field = FieldBars(ctx.recorded.scene)
        sweep = Sweep(ctx.recorded.scene, ctx.names, field)
        first = ctx.recorded.swept(sweep, ctx.shapes.T @ by_position)
        named = sweep.finish(trajectory, 0.0, first).named
        seen = np.tensordot(by_position, trajectory.coordinates, ((0, 2), (0, 2)))
        weights, slopes = field.finish(sweep.products)
        weights = np.concatenate([weights, trajectory.space.weights_of_values(ctx.points, seen)])
        by_weights, by_slopes, by_values = (torch.as_tensor(part).to(ctx.like) for part in (weights, slopes, named))
        return by_weights, by_slopes, by_values, None, None


def rollout_of_weights(
    function: Callable[[Float[Tensor, "P 3"]], Float[Tensor, "P M"]],
    count: int,
    *,
    scene: ReducedScene,
    points: Float[np.ndarray, "n 3"],
    timing: Timing | None = None,
    parameters: Sequence[str] = (),
    values: Float[Tensor, " P"] | None = None,
) -> Float[Tensor, "T n 3"]:
    """Positions [m] of material points at the frames, differentiable once by θ of the weights and by parameters.

    The weights W^θ(X) of `function` move the body of the scene. The derivatives by θ and by all parameters come from
    the adjoint of the roll-out, one backward sweep for all of them (`physconvex.reduced.field_gradient`).

    Args:
        function: float64 rest positions [m] → weights, each row a function of its own point alone, twice differentiable
            by torch; usually a network with parameters θ, such as `NeuralWeights` with layers that require gradients.
        count: M.
        scene: everything but the weights; its body is elastic or damped, and starts in its rest shape.
        points: rest positions [m].
        timing: as in `simulate`; the error of the derivatives is that of Newton's `tolerance`.
        parameters: names, see `physconvex.reduced.PARAMETERS`.
        values: theirs, float64.

    Raises:
        InputError: shapes that do not fit, a body that flows, coordinates given for the start, unknown names.
        ConvergenceError: a time step failed.
    """
    if scene.initial_coordinates is not None:
        raise InputError(
            "scene: got initial_coordinates, which belong to its own weights; leave them out (the body then starts at "
            "rest shape, placed by initial_orientation), and state its place by the parameters initial_position_x "
            "to _z"
        )
    given = torch.zeros(0, dtype=torch.float64) if values is None else values
    if given.shape != (len(parameters),):
        raise InputError(f"values: got shape {tuple(given.shape)}; expected ({len(parameters)},), one per parameter")
    points, samples = checked_points(points), scene.body.space.samples
    weights: WeightField = CallableWeights(function, count)
    if isinstance(function, NeuralWeights) and function.count == count:  # its gradients are cheaper
        weights = function
    scene = replace(scene, body=scene.body.with_space(ReducedSpace(weights, samples)))
    if parameters:
        scene = with_parameters(scene, parameters, given.detach().double().cpu().numpy())
    recorded = RecordedRollOut(scene, timing)
    inside, slopes = _inside(function, samples.interior.points)
    none = np.zeros((0, 3))
    pins = none if scene.pins is None else scene.pins.points
    loads = none if scene.loads is None else scene.loads.points
    others = np.concatenate([samples.surface_points, samples.mass.points, pins, loads, points])
    found = torch.cat([inside, function(torch.tensor(others, dtype=torch.float64))])
    return _WeightsRollOut.apply(found, slopes, given, recorded, (points, tuple(parameters)))


def _inside(
    function: Callable[[Tensor], Tensor], points: Float[np.ndarray, "Q 3"]
) -> tuple[Float[Tensor, "Q M"], Float[Tensor, "Q M 3"]]:
    """Weights and their slopes, both differentiable by θ."""
    where = torch.tensor(points, dtype=torch.float64)
    if isinstance(function, NeuralWeights):
        return function.with_slopes(where)
    values = function(where.requires_grad_())
    return values, weight_slopes(values, where, differentiable=True)
