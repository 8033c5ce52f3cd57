"""The compiled arithmetic of `ContactProblem`."""

from __future__ import annotations

import ctypes
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg.lapack import dgesv
from scipy.sparse import csr_matrix

from physconvex.dynamics import Contact, obstacle_rows
from physconvex.fem.compiled_elements import FEM_KERNEL
from physconvex.fem.contact_problem import ContactProblem
from physconvex.kernels import POINTER, address, doubles

Array = np.ndarray


def contact_kind() -> type[ContactProblem]:
    """Which implementation solves the equation of the forces: plain numpy if nothing can be compiled."""
    return CompiledContact if FEM_KERNEL.available else ContactProblem


def carry(matrix: csr_matrix, x: Float[Array, "V 3"]) -> Float[Array, "S 3"]:
    """B x: points of a surface from the nodes that carry them."""
    if matrix.indices.dtype != np.int32 or not FEM_KERNEL.available:
        return np.asarray(matrix @ x)
    out = np.empty((matrix.shape[0], 3))
    given = (matrix.indptr, matrix.indices, matrix.data, doubles(x), out)
    FEM_KERNEL.library.pc_carry(matrix.shape[0], *map(address, given))
    return out


def add_near(
    law: Contact, x: Float[Array, "S 3"], moved: Float[Array, "S 3"], time: float, near: Bool[Array, "O S"]
) -> None:
    """Set `near` for the points of a law that are inside an obstacle at x or at `moved` [m]."""
    if FEM_KERNEL.available:
        rows, points = obstacle_rows(law.obstacles, time), np.ascontiguousarray(law.nodes, dtype=np.int32)
        given = (doubles(x), doubles(moved))  # named, since a copy must outlive its address
        places = (len(points), address(points), len(x), *map(address, given))
        FEM_KERNEL.library.pc_contact_near(*places, len(rows), address(rows), address(near))
        return
    x, moved = x[law.nodes], moved[law.nodes]
    for number, obstacle in enumerate(law.obstacles):
        near[number, law.nodes] |= (obstacle.gap(x, time) < 0) | (obstacle.gap(moved, time) < 0)


def turned_blocks(
    matrix: Float[Array, "N N"],
    places: Int[Array, " M"],
    turn: Float[Array, "3 3"],
    more: Float[Array, "K K"] | None = None,
) -> Float[Array, "K K"]:
    """R (M + more) Rᵀ, block by block of 3 × 3; M is made of the blocks of a symmetric matrix at some places."""
    count = len(places)
    if FEM_KERNEL.available:
        given = (np.ascontiguousarray(places, dtype=np.int32), more, doubles(turn), np.empty((3 * count, 3 * count)))
        pointers = [None if array is None else address(array) for array in given]
        FEM_KERNEL.library.pc_turned_blocks(len(matrix), address(matrix), count, *pointers)
        return given[-1]
    dofs = (3 * places[:, None] + np.arange(3)).ravel()
    out = matrix[np.ix_(dofs, dofs)] + (0.0 if more is None else more)
    for _ in range(2):
        out = (turn @ out.reshape(count, 3, 3 * count)).reshape(3 * count, -1).T
    return np.ascontiguousarray(out)


class CompiledContact(ContactProblem):
    """The same numbers, compiled.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """

    def _own_compliance(self) -> Float[Array, " C"]:
        out = np.empty(len(self.areas))
        FEM_KERNEL.library.pc_contact_own_compliance(ctypes.byref(self._pairs), address(out))
        return out

    @cached_property
    def _pairs(self) -> _Pairs:
        law, carried = self.law, self.carried
        indices = (carried.indptr, carried.indices, self.obstacles)
        places = [np.ascontiguousarray(array, dtype=np.int32) for array in indices]
        numbers = [doubles(array) for array in (carried.data, self.areas, self.free, self.base, self.compliance)]
        rows = obstacle_rows(law.obstacles, self.time)
        self._kept = places, numbers, rows  # alive as long as their addresses
        *given, compliance = map(address, numbers)
        arrays = (*map(address, places), *given, None, address(rows), compliance)
        constants = law.stiffness, law.smoothing, law.slip_velocity, self.step
        return _Pairs(len(self.areas), carried.shape[1], *arrays, *constants)

    @cached_property
    def _holding(self) -> _Pairs:
        """Pairs with ρ."""
        pairs = self._pairs
        pairs.holds = address(self.stiffness)
        return pairs

    def residual(self, forces: Float[Array, "C 3"]) -> tuple[Float[Array, "C 3"], Float[Array, "C 3 3"]]:
        """λ − R, and D, the derivative of R by its argument."""
        forces = doubles(forces)
        left, slope = np.empty(forces.shape), np.empty((len(forces), 3, 3))
        FEM_KERNEL.library.pc_contact_residual(ctypes.byref(self._holding), *map(address, (forces, left, slope)))
        return left, slope

    def newton_step(self, left: Float[Array, "C 3"], slope: Float[Array, "C 3 3"]) -> Float[Array, "C 3"]:
        """Change δ of the forces, as there; solved on the points themselves if fewer touch than nodes carry them."""
        library, pairs = FEM_KERNEL.library, ctypes.byref(self._holding)
        alone, stiff = np.empty(left.shape), np.empty(slope.shape)
        touching, active = np.empty(len(left), dtype=np.int32), np.empty(self.carried.shape[1], dtype=np.int32)
        counts = np.empty(2, dtype=np.int32)
        given = (doubles(left), doubles(slope), alone, stiff, touching, active, counts)
        library.pc_contact_alone(pairs, *map(address, given))
        points, nodes = counts.tolist()
        if not points:
            return alone
        on_points, size = points <= nodes, 3 * min(points, nodes)
        matrix, right = np.empty((size, size)), np.empty(size)
        made = tuple(map(address, (alone, stiff, matrix, right)))
        if on_points:
            library.pc_contact_on_points(pairs, points, address(touching), *made)
        else:
            library.pc_contact_on_nodes(pairs, points, address(touching), nodes, address(active), *made)
        found = doubles(dgesv(matrix.T, right, overwrite_a=1)[2])
        if on_points:
            alone[touching[:points]] = found.reshape(-1, 3)
        else:
            library.pc_contact_expand(pairs, nodes, *map(address, (active, found, stiff, alone)))
        return alone


class _Pairs(ctypes.Structure):
    """`struct Pairs` of contact.h."""

    _fields_ = (
        ("count", ctypes.c_int32),
        ("nodes", ctypes.c_int32),
        *(
            (name, POINTER)
            for name in (
                "starts", "carriers", "obstacle", "weights", "areas", "free", "base", "holds", "obstacles",
                "compliance",
            )
        ),
        *((name, ctypes.c_double) for name in ("stiffness", "smoothing", "slip_velocity", "step")),
    )  # fmt: skip
