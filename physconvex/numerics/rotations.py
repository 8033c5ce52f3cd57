"""Rotations: by a rotation vector θ with angle |θ| [rad], and the best alignment of point sets."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def best_rotation(
    start: Float[np.ndarray, "V 3"], now: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, " V"] | None = None
) -> Float[np.ndarray, "3 3"]:
    """R with now − c' ≈ R (start − c), c and c' the centres (Kabsch 1976); collinear points leave a turn undetermined.

    `Rotation.align_vectors` gives the same result, but takes four times as long and warns of collinear points.

    Args:
        start, now: the points [m].
        weights: of the points; alike unless given.
    """
    shares = np.full(len(start), 1 / len(start)) if weights is None else weights / weights.sum()
    a, b = start - shares @ start, now - shares @ now
    u, _, vt = np.linalg.svd(b.T @ (a * shares[:, None]))
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def beyond_rigid(
    rest: Float[np.ndarray, "P 3"], positions: Float[np.ndarray, "T P 3"]
) -> tuple[Float[np.ndarray, "T P 3"], Float[np.ndarray, "T 3 3"]]:
    """Displacements of points beyond the best rigid motion of each frame, in space, and its rotations.

    Args:
        rest: the points at rest [m].
        positions: in each frame [m].
    """
    turns = np.stack([best_rotation(rest, now) for now in positions])
    turned = (rest - rest.mean(0)) @ turns.transpose(0, 2, 1)
    return positions - positions.mean(1, keepdims=True) - turned, turns


def rotation_matrix(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """R(θ)."""
    return Rotation.from_rotvec(vector).as_matrix()


def turning_rates(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Columns ω_i with ∂R/∂θ_i = [ω_i]× R, the left Jacobian of the rotation group (Solà et al. 2018, eq. 145)."""
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = float(np.linalg.norm(vector))
    if angle < 1e-4:  # the next terms are of the order θ³
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
