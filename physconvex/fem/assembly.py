"""Sparse assembly on the free degrees of freedom, with a fixed pattern."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from physconvex.fem.compiled_elements import sum_into


def scalar_matrix(tets: Int[np.ndarray, "E n"], local: Float[np.ndarray, "E n n"], size: int) -> sp.csr_matrix:
    """Matrix of one value per node, shape [size, size], from those of the elements."""
    n = tets.shape[1]
    rows, columns = np.repeat(tets, n, axis=1).ravel(), np.tile(tets, n).ravel()
    return sp.coo_matrix((local.ravel(), (rows, columns)), shape=(size, size)).tocsr()


class Assembler:
    """Upper triangle of symmetric matrices over the free nodes of a mesh.

    Args:
        tets: node indices, shape [E, n].
        free: which nodes move, shape [V].
    """

    def __init__(self, tets: Int[np.ndarray, "E n"], free: Bool[np.ndarray, " V"]) -> None:
        self.free = free
        number = np.cumsum(free) - 1
        self.size = 3 * int(free.sum())
        dofs = np.where(free[:, None], 3 * number[:, None] + np.arange(3), -1)  # [V, 3]
        element = dofs[tets].reshape(len(tets), -1)
        rows, columns = element[:, :, None], element[:, None, :]
        keep = (rows >= 0) & (columns >= rows)
        keys = np.broadcast_to(rows * self.size + columns, keep.shape)[keep]
        self._keys, slots = np.unique(keys, return_inverse=True)
        self._slots, self._keep = slots.astype(np.int32), np.flatnonzero(keep).astype(np.int32)
        nodal = dofs[free]
        self._block_slots = np.searchsorted(self._keys, (nodal[:, :, None] * self.size + nodal[:, None, :])[:, *_UPPER])
        indptr = np.searchsorted(self._keys, np.arange(self.size + 1) * self.size)
        self.pattern = sp.csr_matrix(
            (np.ones(len(self._keys)), self._keys % self.size, indptr), shape=(self.size, self.size)
        )

    def elements(self, local: Float[np.ndarray, "E m m"]) -> Float[np.ndarray, " nnz"]:
        """Values of the assembled upper triangle from element matrices."""
        return sum_into(self._slots, self._keep, local, len(self._keys))

    def blocks(self, diagonal: Float[np.ndarray, "V 3 3"]) -> Float[np.ndarray, " nnz"]:
        """Values of the upper triangle from one 3×3 block per node."""
        values = np.zeros(len(self._keys))
        values[self._block_slots] = diagonal[self.free][:, *_UPPER]
        return values


_UPPER = np.triu_indices(3)
