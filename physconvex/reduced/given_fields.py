"""Skinning weights from other sources: any function of points, a predicted field, snapshots of a motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.fem import ElasticBody
from physconvex.reduced.basis import MAX_WEIGHTS, NodalWeights, WeightField, check_count
from physconvex.reduced.elastic_basis import principal_fields


@runtime_checkable
class PredictedField(Protocol):
    """A skinning field as the network predicts it: weights and gradients at points of the object frame [m]."""

    @property
    def handles(self) -> int:
        """M, without the constant weight."""

    def __call__(self, points: Float[np.ndarray, "P 3"]) -> np.ndarray:
        """Weights [-], shape [P, M]."""

    def gradient(self, points: Float[np.ndarray, "P 3"]) -> np.ndarray:
        """∂W/∂X [1/m], shape [P, M, 3]."""


@dataclass(frozen=True)
class ArrayWeights:
    """Weights given by any function of arrays; a `WeightField`.

    Attributes:
        function: rest positions [m], shape [P, 3] → weights, shape [P, M]; each row a function of its own point.
        count: M.
        gradient: the same for ∂W/∂X [1/m], shape [P, M, 3]; central differences of the function unless given.
        difference: step of the differences [m]: about 5e-3 L for a float32 function of a body of size L, 1e-5 L for
            float64.

    Raises:
        InputError: neither `gradient` nor `difference` is given, or `count` is out of range.
    """

    function: Callable[[Float[np.ndarray, "P 3"]], np.ndarray]
    count: int
    gradient: Callable[[Float[np.ndarray, "P 3"]], np.ndarray] | None = None
    difference: float | None = None

    def __post_init__(self) -> None:
        check_count(self.count)
        if self.gradient is None and (self.difference is None or not self.difference > 0):
            raise InputError(
                f"gradient, difference: got None and {self.difference}; expected a function that gives gradients, or "
                "a step > 0 in metres for differences"
            )

    def at(self, points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "P M 3"]]:
        """Values [-] and gradients [1/m] at rest positions [m].

        Raises:
            InputError: a function returns another shape, or values that are not finite.
        """
        points = np.asarray(points, dtype=np.float64)
        values = self._called("function", self.function, points, (len(points), self.count))
        if self.gradient is not None:
            return values, self._called("gradient", self.gradient, points, (len(points), self.count, 3))
        assert self.difference is not None
        slopes = []
        for shift in self.difference * np.eye(3):
            ahead, behind = (self._called("function", self.function, points + s, values.shape) for s in (shift, -shift))
            slopes.append((ahead - behind) / (2 * self.difference))
        return values, np.stack(slopes, axis=-1)

    @staticmethod
    def _called(
        name: str, function: Callable[[np.ndarray], np.ndarray], points: np.ndarray, shape: tuple[int, ...]
    ) -> np.ndarray:
        found = np.asarray(function(points), dtype=np.float64)
        if found.shape != shape or not np.isfinite(found).all():
            raise InputError(f"{name}: gave shape {found.shape}; expected finite values of shape {shape}")
        return found


def predicted_weights(
    field: PredictedField,
    *,
    origin: Sequence[float] | Float[np.ndarray, " 3"] = (0.0, 0.0, 0.0),
    rotation: Float[np.ndarray, "3 3"] | None = None,
    scale: float = 1.0,
) -> ArrayWeights:
    """Weights of a field with its own frame, for example one that the network predicts.

    Args:
        field: weights and gradients at points of its frame.
        origin: position of the frame's origin in the rest body [m]; for a predicted field the centre of the rest
            bounding box.
        rotation: maps vectors of the frame to vectors of the rest body, shape [3, 3]; the identity unless given.
        scale: size of the rest body over that of the object that the field is of.

    Raises:
        InputError: `rotation` is not a rotation, or `scale` is not positive.
    """
    turn = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
    if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
        raise InputError(f"rotation: got {rotation!r}; expected a rotation matrix, shape [3, 3]")
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"scale: got {scale}; expected a positive ratio of sizes")
    start, inverse = np.asarray(origin, dtype=np.float64), turn / scale  # X in the frame = (x − origin) @ inverse
    return ArrayWeights(
        lambda points: field((points - start) @ inverse),
        field.handles,
        gradient=lambda points: np.asarray(field.gradient((points - start) @ inverse), dtype=np.float64) @ inverse.T,
    )


@dataclass(frozen=True)
class StackedWeights:
    """The weights of several fields together, for example eigenmodes and snapshot modes; a `WeightField`.

    Raises:
        InputError: no field, or more than 64 weights together.
    """

    fields: tuple[WeightField, ...]

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MAX_WEIGHTS:
            raise InputError(f"fields: got {self.count} weights together; expected 1 to {MAX_WEIGHTS}")

    @property
    def count(self) -> int:
        """M, the number of weights besides the constant one."""
        return sum(field.count for field in self.fields)

    def at(self, points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "P M 3"]]:
        """Values [-] and gradients [1/m] at rest positions [m]."""
        parts = [field.at(points) for field in self.fields]
        return np.concatenate([p[0] for p in parts], axis=1), np.concatenate([p[1] for p in parts], axis=1)


def snapshot_weights(
    body: ElasticBody, displacements: Sequence[Float[np.ndarray, "T V 3"]], count: int
) -> NodalWeights:
    """Weights from proper orthogonal decomposition (Sirovich 1987) of motions of the body on its own mesh.

    Every component of every snapshot counts as one scalar field. Affine motions, which the constant weight gives, are
    removed. The weights are the `count` fields that carry most of the remainder, ∫ ρ u² dV, so that Σ_m W_m(X) t_m is
    the best approximation of the snapshots by M fields.

    Args:
        body: mesh and density.
        displacements: of its nodes [m], one trajectory or several, each of shape [T, V, 3].
        count: M, number of weights.

    Returns:
        weights normalised to ∫ ρ W² dV = total mass, in decreasing order of their content.

    Raises:
        InputError: a wrong shape, or snapshots with fewer than `count` independent fields beyond affine motions.
    """
    nodes = body.mesh.vertices
    for trajectory in displacements:
        if np.ndim(trajectory) != 3 or np.shape(trajectory)[1:] != nodes.shape or not np.isfinite(trajectory).all():
            raise InputError(f"displacements: got shape {np.shape(trajectory)}; expected finite [T, {len(nodes)}, 3]")
    if not len(displacements):
        raise InputError("displacements: got none; expected at least one trajectory [T, V, 3]")
    columns = np.concatenate([np.moveaxis(np.asarray(u), 1, 0).reshape(len(nodes), -1) for u in displacements], axis=1)
    affine = np.hstack([nodes, np.ones((len(nodes), 1))])
    weighted = body.mass @ affine
    largest = float(np.einsum("vk,vk->k", columns, body.mass @ columns).max(initial=0.0))
    columns = columns - affine @ np.linalg.solve(affine.T @ weighted, weighted.T @ columns)
    modes = principal_fields(columns, body.mass, largest=largest)
    independent = modes.shape[1]
    if not 1 <= count <= min(independent, MAX_WEIGHTS):
        raise InputError(
            f"count: got {count}; the snapshots have {independent} independent fields beyond affine motions; give "
            "fewer weights or more snapshots"
        )
    return NodalWeights(body.mesh, modes[:, :count] * np.sqrt(body.total_mass))
