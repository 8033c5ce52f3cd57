"""Skinning weight functions W_m(X) and their exact gradients at points of the rest body.

A weight field supplies the M varying weights. The constant weight W_0 = 1 always precedes them, so that every field
gives a reduced space with all affine motions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.errors import InputError
from physconvex.fem import ElasticBody, skinning_eigenmodes
from physconvex.mesh import TetMesh, barycentric_gradients, locate, shape_gradients, shape_values

MAX_WEIGHTS = 64
_BLOCK = 20_000  # points located at once


@dataclass(frozen=True)
class SkinningBasis:
    """Skinning weights at points, the constant weight first.

    Attributes:
        points: rest positions [m], shape [P, 3].
        values: W_m at the points [-], shape [P, M + 1]; column 0 is one.
        gradients: ∂W_m/∂X at the points [1/m], shape [P, M + 1, 3]; column 0 is zero.
    """

    points: Float[np.ndarray, "P 3"]
    values: Float[np.ndarray, "P K"]
    gradients: Float[np.ndarray, "P K 3"]


@runtime_checkable
class WeightField(Protocol):
    """M weight functions of the rest position."""

    @property
    def count(self) -> int:
        """M, the number of weights besides the constant one."""

    def at(self, points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "P M 3"]]:
        """Values [-] and gradients [1/m] at rest positions [m]."""


def check_count(count: int) -> None:
    """Raise an InputError unless so many weights are possible."""
    if not 1 <= count <= MAX_WEIGHTS:
        raise InputError(f"count: got {count} weights; expected 1 to {MAX_WEIGHTS} beside the constant one")


@dataclass(frozen=True)
class NodalFunctions:
    """Functions interpolated from the nodes of a tetrahedral mesh by its own shape functions.

    The gradient is that of the interpolation within the element (constant in linear, linear in quadratic elements).
    Outside the mesh they are extrapolated to first order from its nearest point.

    Attributes:
        mesh: background mesh, rest state.
        nodal_values: at the nodes, shape [V, M].

    Raises:
        InputError: `nodal_values` has a wrong shape, or is not finite.
    """

    mesh: TetMesh
    nodal_values: Float[np.ndarray, "V M"]

    def __post_init__(self) -> None:
        values = np.asarray(self.nodal_values, dtype=np.float64)
        if values.ndim != 2 or len(values) != len(self.mesh.vertices) or not np.isfinite(values).all():
            raise InputError(
                f"nodal_values: got shape {values.shape}; expected finite [{len(self.mesh.vertices)}, M], "
                "one row per node of the mesh"
            )
        object.__setattr__(self, "nodal_values", values)

    @property
    def count(self) -> int:
        """M, the number of functions."""
        return self.nodal_values.shape[1]

    @cached_property
    def _barycentric_gradients(self) -> np.ndarray:
        return barycentric_gradients(self.mesh.vertices[self.mesh.corner_tets])

    def at(self, points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "P M 3"]]:
        """Values [-] and gradients [1/m] at rest positions [m]."""
        if not len(points):
            return np.zeros((0, self.count)), np.zeros((0, self.count, 3))
        blocks = np.array_split(np.asarray(points, dtype=np.float64), 1 + len(points) // _BLOCK)
        parts = [self._at_block(block) for block in blocks]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def _at_block(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        elements, barycentric, anchors, _ = locate(self.mesh, points)
        nodal = self.nodal_values[self.mesh.tets[elements]]  # [P, n, M]
        slopes = shape_gradients(anchors, self.mesh.order)  # [P, n, 4]
        shapes = shape_values(anchors, self.mesh.order)
        shapes = shapes + np.einsum("pnb,pb->pn", slopes, barycentric - anchors)
        values = np.einsum("pn,pnm->pm", shapes, nodal)
        by_barycentric = np.einsum("pnb,pnm->pmb", slopes, nodal)
        return values, by_barycentric @ self._barycentric_gradients[elements]


@dataclass(frozen=True)
class NodalWeights(NodalFunctions):
    """Weights interpolated from the nodes of a tetrahedral mesh, at most 64; a `WeightField`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count(self.count)


def eigenmode_weights(body: ElasticBody, count: int) -> NodalWeights:
    """The `count` first skinning eigenmodes of a body on its own mesh (`physconvex.fem.skinning_eigenmodes`).

    Stiffness and density per element enter the modes. Quadratic meshes give much smoother weights than linear ones.

    Raises:
        InputError: `count` is not in 1..64, or too large for the mesh.
    """
    check_count(count)
    return NodalWeights(body.mesh, skinning_eigenmodes(body, count)[0])


@dataclass(frozen=True)
class CallableWeights:
    """Weights given by any torch function of the rest position, for example a network.

    Attributes:
        function: float64 points [P, 3] → weights [P, M], each row a function of its own point alone; its gradient is
            taken by automatic differentiation.
        count: M.
    """

    function: Callable[[Tensor], Tensor]
    count: int

    def __post_init__(self) -> None:
        check_count(self.count)

    def at(self, points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "P M 3"]]:
        """Values [-] and gradients [1/m] at rest positions [m].

        Raises:
            InputError: the function returns another shape than [P, M], or values that are not finite.
        """
        with torch.enable_grad():
            x = torch.tensor(np.asarray(points), dtype=torch.float64, requires_grad=True)
            values = self.function(x)
            if values.shape != (len(x), self.count) or not bool(torch.isfinite(values).all()):
                raise InputError(
                    f"function: gave shape {tuple(values.shape)}; expected finite weights of shape "
                    f"({len(x)}, {self.count}), one row per point"
                )
            gradients = weight_slopes(values, x)
        return values.detach().double().numpy(), gradients.numpy()


def weight_slopes(
    values: Float[Tensor, "P M"], x: Float[Tensor, "P 3"], *, differentiable: bool = False
) -> Float[Tensor, "P M 3"]:
    """∂W_m/∂x of weights, each row a function of its own point; zero where they do not depend on it.

    Args:
        values: the weights.
        x: the points.
        differentiable: whether the result can be differentiated again.
    """
    if not values.requires_grad:
        return torch.zeros(*values.shape, 3).to(x)
    slopes = (
        torch.autograd.grad(
            column.sum(), x, retain_graph=True, create_graph=differentiable, allow_unused=True, materialize_grads=True
        )[0]
        for column in values.T
    )
    return torch.stack(list(slopes), dim=1)


def checked_points(points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
    """Rest positions [m] as float64, or an InputError."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"points: got shape {points.shape}; expected finite [P, 3] in metres")
    return points


def sample_basis(field: WeightField, points: Float[np.ndarray, "P 3"]) -> SkinningBasis:
    """Constant weight and weights of a field at rest positions [m]."""
    points = checked_points(points)
    values, gradients = field.at(points)
    ones, zeros = np.ones((len(points), 1)), np.zeros((len(points), 1, 3))
    return SkinningBasis(points, np.hstack([ones, values]), np.concatenate([zeros, gradients], axis=1))
