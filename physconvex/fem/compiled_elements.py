"""The compiled arithmetic of tetrahedra with a neo-Hookean law and viscosity, and of sums of element matrices."""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from physconvex.kernels import POINTER, SOURCES, Kernel, address, aligned, doubles
from physconvex.materials import KERNEL_LAWS, NEARLY_FLAT, Law, MaterialPoints, StepViscosity

Array = np.ndarray
_MOST_NODES, _MOST_POINTS = 10, 4  # of an element there


class _Elements(ctypes.Structure):
    """`struct Elements` of sources/fem/kernel.cpp."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("count", "points", "nodes", "law")),
        ("flat", ctypes.c_double),
        *((name, POINTER) for name in ("tets", "gradients", "weights", "mu", "lam")),
    )


_NUMBER, _INTEGER = ctypes.c_double, ctypes.c_int32
_BODY: Any = ctypes.POINTER(_Elements)
FEM_KERNEL = Kernel(
    SOURCES / "fem",
    {
        "pc_lanes": (_INTEGER, []),
        "pc_energy_and_forces": (_NUMBER, [_BODY, *[POINTER] * 3, _NUMBER, _NUMBER, POINTER]),
        "pc_stiffness": (_INTEGER, [_BODY, POINTER, POINTER, _NUMBER, POINTER]),
        "pc_assemble": (None, [ctypes.c_int64, *[POINTER] * 4]),
        "pc_carry": (None, [_INTEGER, *[POINTER] * 5]),
        "pc_contact_near": (None, [*(_INTEGER, POINTER) * 2, POINTER, _INTEGER, *[POINTER] * 2]),
        "pc_contact_own_compliance": (None, [POINTER] * 2),
        "pc_contact_residual": (None, [POINTER] * 4),
        "pc_contact_alone": (None, [POINTER] * 8),
        "pc_contact_on_points": (None, [POINTER, _INTEGER, *[POINTER] * 5]),
        "pc_contact_on_nodes": (None, [POINTER, *(_INTEGER, POINTER) * 2, *[POINTER] * 4]),
        "pc_contact_expand": (None, [POINTER, _INTEGER, *[POINTER] * 4]),
        "pc_turned_blocks": (None, [*(_INTEGER, POINTER) * 2, *[POINTER] * 3]),
    },
    include=[SOURCES / "shared"],
)


def compiled_elements(law: Law, tets: Int[Array, "E n"], points: MaterialPoints) -> CompiledElements | None:
    """The quadrature points of a body, see `CompiledElements`; None if these cannot be compiled."""
    small = points.gradients.shape[1] <= _MOST_POINTS and points.gradients.shape[2] <= _MOST_NODES
    known = law.volumetric is not None and small and FEM_KERNEL.available
    return CompiledElements(law, tets, points) if known else None


def sum_into(
    slots: Int[Array, " K"], entries: Int[Array, " K"], values: Float[Array, ...], count: int
) -> Float[Array, " count"]:
    """Sums of entries of an array by the slot that each goes to; both int32 and in range."""
    if not FEM_KERNEL.available:
        return np.bincount(slots, weights=values.reshape(-1)[entries], minlength=count)
    values, out = doubles(values), np.zeros(count)
    FEM_KERNEL.library.pc_assemble(len(slots), *map(address, (entries, slots, values, out)))
    return out


class CompiledElements:
    """The quadrature points of a body of a law Ψ = μ/2 (I₁ − 3) + f(J), with viscosity, several elements at once.

    Args:
        law: one with a `volumetric` part.
        tets: node indices.
        points: Q of each element.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """

    def __init__(self, law: Law, tets: Int[Array, "E n"], points: MaterialPoints) -> None:
        self._law, self._lanes = KERNEL_LAWS.index(law.name), FEM_KERNEL.library.pc_lanes()
        self._shape = points.gradients.shape
        self._blocks = self._by_block(points.gradients)  # [blocks, Q, n, 3, lanes]
        self._tets_by_block = self._by_block(np.asarray(tets, dtype=np.int32))
        self._constants = [self._by_block(array) for array in (points.weights, points.mu, points.lam)]

    def __getstate__(self) -> dict[str, Any]:
        """Without addresses, which are invalid in another process."""
        return {name: value for name, value in self.__dict__.items() if name != "_elements"}

    def _by_block(self, array: Array) -> Array:
        """The elements' entries [E, …] as [blocks, …, lanes], the last one repeated."""
        blocks = -(-len(array) // self._lanes)
        places = np.minimum(np.arange(blocks * self._lanes), len(array) - 1)
        return aligned(np.moveaxis(array[places].reshape(blocks, self._lanes, *array.shape[1:]), 1, -1))

    def energy_and_gradient(self, x: Float[Array, "V 3"]) -> tuple[float, Float[Array, "V 3"]]:
        """Elastic energy [J] and its derivative by the positions of the nodes [N]."""
        x, forces = doubles(x), np.zeros(x.shape)
        energy = FEM_KERNEL.library.pc_energy_and_forces(
            self._elements, address(x), None, None, 0.0, 0.0, address(forces)
        )
        return energy, forces

    def moving_energy_and_gradient(
        self, x: Float[Array, "V 3"], velocity: Float[Array, "V 3"], viscosity: StepViscosity, *, with_energy: bool
    ) -> tuple[float, Float[Array, "V 3"]]:
        """The same with the viscosity of a step, as `ElasticBody.moving_energy_and_gradient`."""
        given = [doubles(array) for array in (x, velocity, viscosity.state.numpy())]
        forces = np.zeros(x.shape)
        energy = FEM_KERNEL.library.pc_energy_and_forces(
            self._elements, *map(address, given), viscosity.damping_time, viscosity.step, address(forces)
        )
        return energy if with_energy else float("nan"), forces

    def stiffness(
        self,
        x: Float[Array, "V 3"],
        *,
        viscosity: StepViscosity | None = None,
        out: Float[Array, "E m m"] | None = None,
    ) -> Float[Array, "E m m"] | None:
        """Element matrices as `ElasticBody.element_hessians`; None where the body is nearly flat at a point."""
        x, width = doubles(x), 3 * self._shape[2]
        state, ratio = (None, 0.0) if viscosity is None else (doubles(viscosity.state.numpy()), viscosity.ratio)
        out = np.empty((self._shape[0], width, width)) if out is None else out
        given = self._elements, address(x), None if state is None else address(state)
        return out if FEM_KERNEL.library.pc_stiffness(*given, ratio, address(out)) else None

    @cached_property
    def _elements(self) -> _Elements:
        count, points, nodes, _ = self._shape
        arrays = (self._tets_by_block, self._blocks, *self._constants)
        return _Elements(count, points, nodes, self._law, NEARLY_FLAT, *map(address, arrays))
