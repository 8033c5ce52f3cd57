"""Proper orthogonal decomposition of fields at the nodes of a mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

__all__ = ["principal_fields"]

_NEGLIGIBLE = 1e-10  # share of the square norm below which a field is rounding


def principal_fields(
    fields: Float[np.ndarray, "V K"], norm: sp.csr_matrix, *, largest: float | None = None
) -> Float[np.ndarray, "V R"]:
    """What fields span, orthonormal in a norm, those that carry most of them first (Sirovich 1987).

    Args:
        fields: as columns.
        norm: symmetric and positive, shape [V, V].
        largest: square norm against which rounding is judged; that of the first result unless given.

    Returns:
        as many columns as the fields have independent directions.
    """
    squares, mixing = np.linalg.eigh(fields.T @ (norm @ fields))
    squares, mixing = squares[::-1], mixing[:, ::-1]
    kept = squares > _NEGLIGIBLE * (squares.max(initial=0.0) if largest is None else largest)
    return np.asarray(fields @ (mixing[:, kept] / np.sqrt(squares[kept])))
