"""Share of a motion that skinning weights can represent: φ(X) = X + Σₘ Wₘ(X) Zₘ [X; 1], with W₀ = 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def captured_energy(
    displacements: Float[np.ndarray, "T Q 3"],
    *,
    rest: Float[np.ndarray, "Q 3"],
    volume_weights: Float[np.ndarray, " Q"],
    weights: Float[np.ndarray, "Q M"],
    after: Literal["nothing", "affine"] = "nothing",
) -> float:
    """Share of the displacement energy Σ_t Σ_q v_q |u|² that the best Z(t) capture, 0..1.

    The constant mode is always among the handles. With `after="affine"` the best affine motion of each frame, which the
    constant mode represents, is removed first, so that only the effect of the handles counts.

    Args:
        displacements: of Q points in T frames [m].
        rest: rest positions [m].
        volume_weights: volume of each point [m³].
        weights: W at the points, without the constant mode.
    """
    root = np.sqrt(np.asarray(volume_weights, np.float64))[:, None]
    motion = np.moveaxis(np.asarray(displacements, np.float64), 0, 1).reshape(len(rest), -1) * root
    homogeneous = np.concatenate([_normalised(rest), np.ones((len(rest), 1))], axis=1)
    if after == "affine":
        motion = _remainder(motion, homogeneous * root)
    total = float((motion**2).sum())
    if total == 0.0:
        return 1.0
    handles = np.concatenate([np.ones((len(rest), 1)), np.asarray(weights, np.float64)], axis=1)
    basis = np.einsum("qm,qi->qmi", handles, homogeneous).reshape(len(rest), -1)
    return 1.0 - float((_remainder(motion, basis * root) ** 2).sum()) / total


def _normalised(rest: Float[np.ndarray, "Q 3"]) -> Float[np.ndarray, "Q 3"]:
    points = np.asarray(rest, np.float64)
    return (points - points.mean(axis=0)) / np.ptp(points, axis=0).max()


def _remainder(motion: Float[np.ndarray, "Q N"], basis: Float[np.ndarray, "Q B"]) -> Float[np.ndarray, "Q N"]:
    """Residual of the basis, by least squares; directions below 1e-8 of the largest are ignored."""
    left, sizes, _ = np.linalg.svd(basis, full_matrices=False)
    left = left[:, sizes > 1e-8 * sizes[0]]
    return motion - left @ (left.T @ motion)


def random_basis(
    count: int, *, generator: np.random.Generator
) -> Callable[[Float[np.ndarray, "Q 3"]], Float[np.ndarray, "Q M"]]:
    """Random smooth fields cos(k·X + φ) of points in units of the object size: the baseline of any basis.

    Components of k are normal with standard deviation π, half a wave over the object.
    """
    waves = np.pi * generator.standard_normal((3, count))
    phases = generator.uniform(0, 2 * np.pi, count)
    return lambda points: np.cos(np.asarray(points) @ waves + phases)


def span_loss(
    weights: Float[Tensor, "B Q M"],
    modes: Float[Tensor, "B Q K"],
    volume_weights: Float[Tensor, "B Q"],
    importance: Float[Tensor, "B K"],
) -> Float[Tensor, " B"]:
    """Share of the modes that span{1, W} misses, importance-weighted mean, 0..1; only the span counts.

    1 − ‖P u_k‖² / ‖u_k‖² per mode, in the volume-weighted inner product, constants taken out of both.
    """
    measure = (volume_weights / volume_weights.sum(dim=1, keepdim=True)).double()
    basis, target = _unit_columns(weights, measure), _unit_columns(modes, measure)
    captured = _projections(basis, target).square().sum(dim=1)
    share = importance.double() / importance.double().sum(dim=1, keepdim=True)
    return (share * (1 - captured)).sum(dim=1).float()


def captured_energy_loss(
    weights: Float[Tensor, "B Q M"],
    displacements: Float[Tensor, "B Q N"],
    points: Float[Tensor, "B Q 3"],
    volume_weights: Float[Tensor, "B Q"],
) -> Float[Tensor, " B"]:
    """Share of the motion beyond the best affine one that the handles miss, 0..1.

    `displacements` holds any number of frames and components side by side, `points` the rest positions in
    units of the object size.
    """
    root = (volume_weights / volume_weights.sum(dim=1, keepdim=True)).double().sqrt()[..., None]
    homogeneous = torch.cat([points, torch.ones_like(points[..., :1])], dim=-1).double()
    affine = torch.linalg.qr(homogeneous * root).Q
    motion = displacements.double() * root
    motion = motion - affine @ (affine.transpose(1, 2) @ motion)
    handles = (weights.double()[..., :, None] * homogeneous[..., None, :]).flatten(2) * root
    handles = handles - affine @ (affine.transpose(1, 2) @ handles)
    handles = handles / (handles.norm(dim=1, keepdim=True) + 1e-6)
    energy = motion.square().sum(dim=(1, 2))
    projected = _projections(handles, motion).square().sum(dim=(1, 2))
    return (1 - projected / (energy + 1e-12)).float()


def _unit_columns(fields: Float[Tensor, "B Q N"], measure: Float[Tensor, "B Q"]) -> Float[Tensor, "B Q N"]:
    """√measure times the fields, without their mean, each of norm one."""
    fields = fields.double()
    centred = fields - (measure[:, None] @ fields)
    scaled = centred * measure.sqrt()[..., None]
    return scaled / (scaled.norm(dim=1, keepdim=True) + 1e-6)


def _projections(basis: Float[Tensor, "B Q M"], target: Float[Tensor, "B Q K"]) -> Float[Tensor, "B M K"]:
    """Coefficients of the target in an orthonormal basis of the span; jitter keeps it differentiable."""
    gram = basis.transpose(1, 2) @ basis
    jitter = 1e-6 * torch.eye(gram.shape[-1], dtype=gram.dtype, device=gram.device)
    factor = torch.linalg.cholesky(gram + jitter)
    return torch.linalg.solve_triangular(factor, basis.transpose(1, 2) @ target, upper=False)
