"""The compiled arithmetic of `VolumetricSamples`."""

from __future__ import annotations

import ctypes
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg.blas import dsyrk

from physconvex.materials import Law
from physconvex.native import KernelUnavailable, address, aligned, compiled
from physconvex.reduced.volumetric import VolumetricSamples
from physconvex.volumetric_laws import HEADERS, KERNEL_LAWS, NEARLY_FLAT

__all__ = ["SOURCES", "CompiledSamples", "load_library", "volumetric_samples"]

Array = np.ndarray
SOURCES = Path(__file__).with_name("cpu")
_POINTER: Any = ctypes.c_void_p


def volumetric_samples(law: Law, gradients: Array, weights: Array, mu: Array, lam: Array) -> VolumetricSamples:
    """The samples of a body, see `VolumetricSamples`; those of plain numpy where nothing can be compiled."""
    given = (law, gradients, weights, mu, lam)
    if law.name not in KERNEL_LAWS:
        return VolumetricSamples(*given)
    try:
        return CompiledSamples(*given)
    except KernelUnavailable:
        return VolumetricSamples(*given)


class CompiledSamples(VolumetricSamples):
    """The same numbers, the gradients read once for each energy with its forces.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """

    def __init__(self, law: Law, gradients: Array, weights: Array, mu: Array, lam: Array) -> None:
        super().__init__(law, gradients, weights, mu, lam)
        self._law, self._lanes = KERNEL_LAWS.index(law.name), load_library().pc_lanes()
        count = len(weights)
        blocks = -(-count // self._lanes)
        padded = np.zeros((blocks * self._lanes, 3, self._size))
        padded[:count] = self._gradients
        self._blocks = aligned(padded.reshape(blocks, self._lanes, 3, self._size).transpose(0, 3, 2, 1))

    def __getstate__(self) -> dict[str, Any]:
        """Without addresses, which another process cannot use."""
        return {name: value for name, value in self.__dict__.items() if name != "_body"}

    def _energy_and_forces(self, body: _Body, y: Float[Array, "R 3"]) -> tuple[float, Float[Array, "R 3"]]:
        y, forces = np.ascontiguousarray(y), np.empty(y.shape)
        energy = load_library().pc_energy_and_forces(body, address(y), address(forces))
        return energy, forces

    def energy_and_gradient(self, y: Float[Array, "R 3"]) -> tuple[float, Float[Array, "R 3"]]:
        """Elastic energy [J] and its derivative by the coordinates [N]."""
        return self._energy_and_forces(self._body, y)

    def gradient_with(self, y: Float[Array, "R 3"], mu: Array, lam: Array) -> Float[Array, "R 3"]:
        """The derivative [N] with other constants μ and λ [Pa], shape [Q]."""
        mu, lam = np.ascontiguousarray(mu), np.ascontiguousarray(lam)
        return self._energy_and_forces(self._body_with(mu, lam), y)[1]

    def hessian_blocks(self, y: Float[Array, "R 3"]) -> Float[Array, "3 R 3 R"] | None:
        """Second derivative [N/m], components first; None where the body is nearly flat at a sample."""
        count = len(self._weights)
        y, u, turned = np.ascontiguousarray(y), np.empty((count, 3, self._size)), np.empty((count, 2, self._size))
        if not load_library().pc_cofactor_gradients(self._body, *map(address, (y, u, turned))):
            return super().hessian_blocks(y)
        product = dsyrk(1.0, u.reshape(count, -1).T, lower=1).T  # the upper half
        parts, last = u[:, 0].T @ turned.reshape(count, -1), u[:, 1].T @ turned[:, 1]
        load_library().pc_assemble(self._size, *map(address, (self._constant, parts, last, product)))
        return product.reshape(3, self._size, 3, self._size)

    @cached_property
    def _body(self) -> _Body:
        return self._body_with(self._mu, self._lam)

    def _body_with(self, mu: Float[Array, " Q"], lam: Float[Array, " Q"]) -> _Body:
        """These constants must live as long as it does."""
        arrays = (self._blocks, self._gradients, self._weights, mu, lam)
        return _Body(len(self._weights), self._size, self._law, NEARLY_FLAT, *map(address, arrays))


class _Body(ctypes.Structure):
    """`struct Body` of cpu/kernel.cpp."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("samples", "functions", "law")),
        ("flat", ctypes.c_double),
        *((name, _POINTER) for name in ("blocks", "gradients", "weights", "mu", "lam")),
    )


@cache
def load_library() -> ctypes.CDLL:
    """The library with its functions' types declared.

    Raises:
        KernelUnavailable: no compiler, or it failed.
    """
    library = ctypes.CDLL(str(compiled(SOURCES, include=[HEADERS])))
    body: Any = ctypes.POINTER(_Body)
    library.pc_lanes.restype = ctypes.c_int32
    library.pc_energy_and_forces.argtypes = [body] + [_POINTER] * 2
    library.pc_energy_and_forces.restype = ctypes.c_double
    library.pc_cofactor_gradients.argtypes = [body] + [_POINTER] * 3
    library.pc_cofactor_gradients.restype = ctypes.c_int32
    library.pc_assemble.argtypes, library.pc_assemble.restype = [ctypes.c_int32] + [_POINTER] * 4, None
    return library
