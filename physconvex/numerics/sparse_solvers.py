"""Sparse symmetric direct solver that keeps its symbolic factorisation.

MKL Pardiso if `pypardiso` is installed, otherwise SciPy's SuperLU with a warning. Measured on 27,800 unknowns: Pardiso
1.8 s the first time, 0.13 s after; SuperLU 10.5 s.
"""

from __future__ import annotations

import os
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from physconvex.errors import InputError, PhysconvexError

Backend = Literal["auto", "pardiso", "superlu"]
# of Pardiso: use these instead of defaults; nested dissection; no iterative refinement of solutions, which makes them
# four times as fast
_SETTINGS = {1: 1, 2: 2, 8: 0}
_COLUMNS = 64  # solved for at once: more right sides and solutions exceed the processor's caches


class NotPositiveDefiniteError(PhysconvexError, ArithmeticError):
    """The matrix has a pivot that is not positive."""


@cache
def _pardiso_class() -> type | None:
    # pypardiso searches the whole environment for MKL at every construction unless it gets the path
    libraries = sorted(Path(sys.prefix, "lib").glob("libmkl_rt.so*"))
    if libraries:
        os.environ.setdefault("PYPARDISO_MKL_RT", str(libraries[0]))
    try:
        from pypardiso import PyPardisoSolver
    except ImportError:
        warnings.warn(
            "pypardiso is not installed: falling back to SciPy's SuperLU, which is many times slower on large meshes "
            "(remedy on x86: pip install pypardiso)",
            RuntimeWarning,
            stacklevel=3,
        )
        return None
    return PyPardisoSolver


class SymmetricSolver:
    """Cholesky (Pardiso) or LU (SuperLU) of symmetric positive definite matrices that share one sparsity pattern.

    Args:
        upper: pattern, CSR, upper triangle with the whole diagonal present; shape [n, n].
        backend: "pardiso", "superlu", or "auto" (Pardiso if installed).
    """

    def __init__(self, upper: sp.csr_matrix, *, backend: Backend = "auto") -> None:
        if backend not in ("auto", "pardiso", "superlu"):
            raise InputError(f"backend: got {backend!r}; expected 'auto', 'pardiso' or 'superlu'")
        pardiso = None if backend == "superlu" else _pardiso_class()
        if backend == "pardiso" and pardiso is None:
            raise InputError("backend: got 'pardiso'; pypardiso is not installed (pip install pypardiso)")
        self._upper = upper.astype(np.float64).sorted_indices()
        self._pardiso = pardiso(mtype=2) if pardiso else None
        if self._pardiso is not None:
            for number, value in _SETTINGS.items():
                self._pardiso.set_iparm(number, value)
        self._analysed = False
        self._lu: object = None
        self.factorisations = 0

    def factorise(self, data: Float[np.ndarray, " nnz"]) -> None:
        """Factorise the matrix whose upper-triangle values are `data`.

        Raises:
            NotPositiveDefiniteError: a pivot is not positive (SuperLU: the diagonal of U has a value ≤ 0).
        """
        self.factorisations += 1
        self._upper.data = np.ascontiguousarray(data, dtype=np.float64)
        if not np.isfinite(self._upper.data).all():
            raise NotPositiveDefiniteError("the matrix has entries that are not finite")
        if self._pardiso is None:
            self._factorise_superlu()
        else:
            self._factorise_pardiso()

    def solve(self, rhs: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "n ..."]:
        """Solution of A x = rhs with the last factorised matrix."""
        if self._pardiso is None:
            return self._lu.solve(np.ascontiguousarray(rhs))  # type: ignore[attr-defined]
        self._pardiso.set_phase(33)
        return self._pardiso._call_pardiso(self._upper, np.asfortranarray(rhs))

    def inverse_rows(self, numbers: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k n"]:
        """Those rows of A⁻¹, A the last factorised matrix: in blocks that fit into the caches."""
        rows = np.empty((len(numbers), self._upper.shape[0]))
        for first in range(0, len(numbers), _COLUMNS):
            some = numbers[first : first + _COLUMNS]
            units = np.zeros((self._upper.shape[0], len(some)), order="F")
            units[some, np.arange(len(some))] = 1.0
            rows[first : first + _COLUMNS] = self.solve(units).T
        return rows

    def _factorise_pardiso(self) -> None:
        from pypardiso.pardiso_wrapper import PyPardisoError

        assert self._pardiso is not None
        self._pardiso.set_phase(22 if self._analysed else 12)
        try:
            self._pardiso._call_pardiso(self._upper, np.zeros((self._upper.shape[0], 1)))
        except PyPardisoError as error:
            self._analysed = False
            if error.value == -4:
                raise NotPositiveDefiniteError("a pivot is not positive") from error
            raise
        self._analysed = True

    def _factorise_superlu(self) -> None:
        full = (self._upper + sp.triu(self._upper, 1).T).tocsc()
        try:
            lu = splu(full, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError as error:
            raise NotPositiveDefiniteError("the matrix is singular") from error
        if (lu.U.diagonal() <= 0).any():
            raise NotPositiveDefiniteError("a pivot is not positive")
        self._lu = lu

    def close(self) -> None:
        """Free the factorisation's memory (Pardiso keeps it outside Python)."""
        if self._pardiso is not None:
            self._pardiso.free_memory(everything=True)
            self._analysed = False
