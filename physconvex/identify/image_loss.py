"""The paper's loss of a simulation (eq. 9), and its derivatives by E, ν and the network θ of the skinning weights.

L_sim = 1/(S P) Σ ‖C − C_gt‖² over S frames and P pixels: the model moves the convexes' points, and these are rendered.
Torch differentiates the images by the points; the adjoint of the reduced simulation carries that derivative to E, ν and
θ in one backward sweep. With θ the shape functions change also at the convexes' points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from physconvex.dynamics import Timing
from physconvex.errors import InputError
from physconvex.identify.observations import StackedObservations
from physconvex.identify.photometric import PhotometricObservations
from physconvex.identify.twin import Twin, with_body
from physconvex.reduced import NeuralWeights, ReducedSpace, parameter_values, rollout_of_weights

_POSITION = tuple(f"initial_position_{axis}" for axis in "xyz")


class _ImageLoss(torch.autograd.Function):
    """The loss as a function of the points; the forward pass computes the derivative, frame by frame."""

    @staticmethod
    def forward(ctx: Any, positions: Tensor, seen: Sequence[PhotometricObservations], scale: float) -> Tensor:
        total, slopes = positions.new_zeros(()), torch.zeros_like(positions)
        wanted = ctx.needs_input_grad[0]
        for one, where in zip(seen, _slices(seen), strict=True):
            for frame in np.flatnonzero(one.sizes):
                points = positions[frame, where].detach().to(one.field.points).reshape(one.field.points.shape)
                with torch.set_grad_enabled(wanted):
                    part = scale * _squares(one, int(frame), points.requires_grad_(wanted))
                if wanted:
                    (slope,) = torch.autograd.grad(part, points)
                    slopes[frame, where] = slope.reshape(-1, 3).to(slopes)
                total += part.detach().to(total)
        ctx.save_for_backward(slopes)
        return total

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (slopes,) = ctx.saved_tensors
        return gradient * slopes, None, None


def _slices(seen: Sequence[PhotometricObservations]) -> Sequence[slice]:
    """The points of each among those of all."""
    return StackedObservations(tuple(seen)).point_slices


def simulation_loss(positions: Float[Tensor, "T P 3"], seen: Sequence[PhotometricObservations]) -> Float[Tensor, ""]:
    """L_sim: the mean over compared pixels and frames of the squared distance of the colours, which lie in 0 … 1.

    Blur, exposure and robust threshold are those of the observations: with `robust_scale` = inf, `exposure` = False and
    no blur it is the paper's. It is 2 σ² over the number of pixels times the misfit that `fit` minimises.

    Args:
        positions: of the points of all observations, one after the other [m]; differentiable once by them.
        seen: images of one camera each.

    Raises:
        InputError: no observations, or another number of frames or points than theirs.
    """
    shape = [len(one.images) for one in seen[:1]], sum(len(one.points) for one in seen)
    if not seen or any(tuple(positions.shape) != (len(one.images), shape[1], 3) for one in seen):
        raise InputError(f"positions: got {tuple(positions.shape)}; expected [T, P, 3] of seen, T and P: {shape}")
    return _ImageLoss.apply(positions, tuple(seen), 1 / sum(int(one.sizes.sum()) for one in seen))


def _squares(seen: PhotometricObservations, frame: int, points: Float[Tensor, "N K 3"]) -> Float[Tensor, ""]:
    """Σ ‖C − C_gt‖² of a frame's window; beyond the robust threshold linear in each colour."""
    a, b, c, d = seen.windows[frame]
    drawn, observed = seen.rendered(points, seen.windows[frame]), seen.blurred(seen.images[frame, a:b, c:d])
    if seen.blur:
        down, across = (torch.as_tensor(_blur_matrix(seen, size)).to(drawn) for size in (b - a, d - c))
        drawn = torch.einsum("ij,jkc,lk->ilc", down, drawn, across)
    left = (drawn - torch.as_tensor(observed).to(drawn)).flatten()
    if seen.exposure:
        columns = np.stack([observed.ravel(), np.ones(observed.size)], axis=1).astype(np.float64)
        basis = torch.as_tensor(np.linalg.qr(columns)[0]).to(left)
        left = left - basis @ (basis.T @ left)
    if np.isinf(seen.robust_scale):
        return left.square().sum()
    limit, size = seen.robust_scale * seen.sigma, left.abs()
    return torch.where(size <= limit, left.square(), limit * (2 * size - limit)).sum()


def _blur_matrix(seen: PhotometricObservations, size: int) -> Float[np.ndarray, "n n"]:
    """The blur along one axis."""
    return seen.blurred(np.eye(size)[:, None])[:, 0]


def of_visible(
    seen: Sequence[PhotometricObservations], positions: Float[Tensor, "T P 3"]
) -> tuple[PhotometricObservations, ...]:
    """Each of the observations with the convexes alone that its camera sees in a motion.

    Args:
        seen: images of one camera each.
        positions: of the points of all observations, one after the other [m].
    """
    moved = positions.detach().double().numpy()
    with torch.enable_grad():
        return tuple(one.visible_in(moved[:, where]) for one, where in zip(seen, _slices(seen), strict=True))


def moved_points(
    twin: Twin,
    weights: NeuralWeights,
    points: Float[np.ndarray, "P 3"],
    timing: Timing,
    *,
    parameters: Sequence[str] = (),
    values: Float[Tensor, " K"] | None = None,
) -> Float[Tensor, "T P 3"]:
    """Positions [m] of points of a twin at the frames, differentiable by θ (`weights.layers`) and by parameters.

    Args:
        twin: body and world; its own skinning weights are not used.
        weights: W^θ.
        points: rest positions [m].
        timing: of the roll-out.
        parameters: names, see `physconvex.reduced.PARAMETERS`.
        values: theirs, float64; the twin's own unless given.

    Raises:
        InputError: unknown names, values out of range, a body that flows.
        ConvergenceError: a time step failed.
    """
    names, scene = list(parameters), twin.scene
    found = torch.as_tensor(parameter_values(scene, names)) if values is None and names else values
    if scene.initial_coordinates is not None:
        place = [name for name in _POSITION if name not in names]
        where = torch.as_tensor(parameter_values(scene, place)) if place else torch.zeros(0, dtype=torch.float64)
        found = where if found is None else torch.cat([found, where])
        names, scene = names + place, replace(scene, initial_coordinates=None)
    return rollout_of_weights(
        weights, weights.count, scene=scene, points=points, timing=timing, parameters=names, values=found
    )


def with_few_samples(twin: Twin) -> Twin:
    """The twin with the mass at the samples of the energy, of which there are few.

    The networks of weights are then evaluated at a few thousand points instead of a hundred thousand.
    """
    body = twin.scene.body
    samples = replace(body.space.samples, mass=body.space.samples.interior)
    return with_body(twin, body.with_space(ReducedSpace(body.space.field, samples)))
