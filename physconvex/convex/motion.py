"""Vertex dynamics: convexes whose points move with a deformation of the body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csr_matrix
from torch import Tensor

from physconvex.convex.field import ConvexField, numbers
from physconvex.convex.spherical_harmonics import rotate_harmonics
from physconvex.errors import InputError
from physconvex.mesh import Embedding, Places, TetMesh, locate, shape_gradients
from physconvex.reduced import ReducedSpace

_NEWTON_STEPS = 8  # of the polar decomposition; more are not needed unless F is nearly flat

DeformationMap = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Rest positions X [P, 3] to positions x [*T, P, 3], both in metres, and gradients ∂x_i/∂X_j [*T, P, 3, 3].

`advect` takes a map of one state, T = (). Maps of several states serve to split and merge for a whole motion.
"""


def affine_map(linear: Float[Tensor, "3 3"], shift: Float[Tensor, " 3"]) -> DeformationMap:
    """x = linear X + shift."""

    def deform(points: Tensor) -> tuple[Tensor, Tensor]:
        gradient = linear.to(points)
        return points @ gradient.T + shift.to(points), gradient.expand(len(points), 3, 3)

    return deform


def advect(field: ConvexField, deform: DeformationMap) -> ConvexField:
    """The field under a deformation: points move with it, colours rotate with the rotation at the centres.

    Smoothness and sharpness are constant, so that edges keep their width in metres.

    Args:
        deform: the map X ↦ x with its gradient.
    """
    positions, _ = deform(field.points.reshape(-1, 3))
    _, gradients = deform(field.centres)
    return _carried(field, positions.reshape(field.points.shape), gradients)


def _carried(field: ConvexField, points: Tensor, gradients: Float[Tensor, "N 3 3"]) -> ConvexField:
    return replace(field, points=points, harmonics=rotate_harmonics(field.harmonics, polar_rotation(gradients)))


def polar_rotation(gradients: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3 3"]:
    """The rotations R of F = R S (polar decomposition); with F = V Σ Wᵀ, R = V diag(1, 1, det V det W) Wᵀ.

    The nearest rotation, also if F inverts the body. Differentiable once, also where singular values are equal (as at
    rest): Ṙ = R [ω]ₓ with (tr S − S) ω the axial vector of Rᵀ Ḟ − Ḟᵀ R.
    """
    given = gradients.detach()
    rotation = _nearest_rotations(given)
    if not gradients.requires_grad:
        return rotation
    stretch = rotation.mT @ given
    inertia = stretch.diagonal(dim1=1, dim2=2).sum(dim=1)[:, None, None] * torch.eye(3).to(given) - stretch
    change = rotation.mT @ gradients  # symmetric at the given gradients
    skew = change - change.mT
    axial = torch.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], dim=1)
    # damped, since an inverted body may leave the rotation undetermined
    square = inertia.mT @ inertia
    damping = 10 * torch.finfo(given.dtype).eps * square.diagonal(dim1=1, dim2=2).sum(dim=1)[:, None, None]
    damped = square + damping.clamp(min=torch.finfo(given.dtype).tiny) * torch.eye(3).to(given)
    x, y, z = torch.linalg.solve_ex(damped, inertia.mT @ axial[..., None])[0][..., 0].unbind(dim=1)
    zero = torch.zeros_like(x)
    turn = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)
    return rotation + rotation @ turn


def _nearest_rotations(gradients: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3 3"]:
    """By Newton's iteration R ← ½ (γ R + R⁻ᵀ/γ) (Higham 1986); by singular values if F is inverted or flat."""
    found = gradients
    for _ in range(_NEWTON_STEPS):
        cofactors = torch.stack([found[:, k - 2].cross(found[:, k - 1], dim=1) for k in range(3)], dim=1)
        volume = (found[:, 0] * cofactors[:, 0]).sum(dim=1)[:, None, None]
        inverse = cofactors / volume  # transposed
        scale = (inverse.square().sum((1, 2), True) / found.square().sum((1, 2), True)).pow(0.25)
        last, found = found, 0.5 * (scale * found + inverse / scale)
    settled = (found - last).abs().amax((1, 2)) < 30 * torch.finfo(found.dtype).eps
    rest = ~(settled & (volume[:, 0, 0] > 0))
    if rest.any():
        left, _, right = torch.linalg.svd(gradients[rest])
        sign = torch.det(left @ right).sign()
        flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=-1)
        found = found.index_put((rest,), (left * flip[:, None]) @ right)
    return found


@dataclass(frozen=True, eq=False)
class BoundField:
    """A field bound to a body whose positions are linear in coordinates q [D, 3], such as the nodes of a mesh.

    Attributes:
        field: the field at rest.
        positions: positions of all points from q, shape [N K, D].
        gradients: ∂/∂X_j at the centres from q, shape [N 3, D], row 3 n + j, 1/m.
        max_distance: distance of the outermost point from the body [m]; such points extrapolate its motion.
    """

    field: ConvexField
    positions: Any
    gradients: Any
    max_distance: float = 0.0

    def at(self, coordinates: Float[np.ndarray, "D 3"]) -> ConvexField:
        """The field for these coordinates of the body [m].

        Raises:
            InputError: another number of coordinates than those of the body.
        """
        values = np.asarray(coordinates, dtype=np.float64)
        if values.shape != (self.positions.shape[1], 3):
            raise InputError(f"coordinates: got shape {values.shape}; expected [{self.positions.shape[1]}, 3]")
        points = np.asarray(self.positions @ values).reshape(self.field.points.shape)
        gradients = np.asarray(self.gradients @ values).reshape(-1, 3, 3).swapaxes(1, 2)
        kind = self.field.points
        return _carried(self.field, torch.as_tensor(points).to(kind), torch.as_tensor(gradients).to(kind))


def bind_to_tets(field: ConvexField, mesh: TetMesh) -> BoundField:
    """Bind to the nodes of a tetrahedral mesh at rest, by the shape functions of the element that holds each point.

    `BoundField.at` then takes nodal positions [V, 3], such as `Trajectory.positions[t]`.
    """
    embedding = Embedding.of_points(mesh, numbers(field.points).reshape(-1, 3))
    return BoundField(
        field, embedding.matrix, _tet_gradients(mesh, locate(mesh, numbers(field.centres))), embedding.max_distance
    )


def _tet_gradients(mesh: TetMesh, places: Places) -> csr_matrix:
    """∂/∂X_j at located points from nodal positions, shape [P 3, V], row 3 p + j, 1/m."""
    elements, _, anchors, _ = places
    corners = mesh.vertices[mesh.corner_tets[elements]]
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))  # rows: gradients of λ_1 to λ_3
    slopes = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    gradients = np.einsum("pnk,pkj->pjn", shape_gradients(anchors, mesh.order), slopes)  # [P, 3, n]
    nodes = np.repeat(mesh.tets[elements][:, None], 3, axis=1)
    rows = np.arange(0, gradients.size + 1, gradients.shape[2])
    return csr_matrix((gradients.ravel(), nodes.ravel(), rows), shape=(3 * len(elements), len(mesh.vertices)))


def bind_to_space(field: ConvexField, space: ReducedSpace) -> BoundField:
    """Bind to a reduced body.

    `BoundField.at` then takes its coordinates [R, 3], such as `ReducedTrajectory.coordinates[t]`.
    """
    gradients = np.swapaxes(space.shape_gradients(numbers(field.centres)), 1, 2)  # [N, 3, R]
    values = space.shape_values(numbers(field.points).reshape(-1, 3))
    return BoundField(field, values, gradients.reshape(-1, gradients.shape[2]))


def space_map(space: ReducedSpace, coordinates: Float[np.ndarray, "*T R 3"]) -> DeformationMap:
    """The deformation of a reduced body at coordinates y [m]: x = Σ_a N_a(X) y_a with its gradient; of several states
    if there is a first axis."""

    def deform(points: Tensor) -> tuple[Tensor, Tensor]:
        rest = numbers(points)
        gradients = np.einsum("pri,...rk->...pki", space.shape_gradients(rest), coordinates)
        return torch.as_tensor(space.shape_values(rest) @ coordinates).to(points), torch.as_tensor(gradients).to(points)

    return deform


def tet_map(mesh: TetMesh, positions: Float[np.ndarray, "*T V 3"]) -> DeformationMap:
    """The deformation of a tetrahedral mesh whose nodes are at these positions [m], with its gradient; of several
    states if there is a first axis."""
    states = np.reshape(positions, (-1, len(mesh.vertices), 3))

    def deform(points: Tensor) -> tuple[Tensor, Tensor]:
        rest, shape = numbers(points), np.shape(positions)[:-2]
        by_nodes = np.moveaxis(states, 0, 1).reshape(len(mesh.vertices), -1)  # [V, T 3]
        places = locate(mesh, rest)
        slopes = (_tet_gradients(mesh, places) @ by_nodes).reshape(len(rest), 3, len(states), 3)  # [P, j, T, i]
        gradients = slopes.transpose(2, 0, 3, 1).reshape(*shape, len(rest), 3, 3)
        moved = Embedding.at_places(mesh, places).apply(states).reshape(*shape, len(rest), 3)
        return torch.as_tensor(moved).to(points), torch.as_tensor(gradients).to(points)

    return deform
