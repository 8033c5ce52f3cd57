"""Rotation vectors: θ turns by |θ| [rad] about its own direction."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

__all__ = ["rotation_matrix", "turning_rates"]


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
