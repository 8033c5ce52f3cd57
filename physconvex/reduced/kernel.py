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
from physconvex.native import POINTER, Functions, address, aligned, available, doubles, loaded
from physconvex.reduced.volumetric import VolumetricSamples
from physconvex.volumetric_laws import HEADERS, KERNEL_LAWS, NEARLY_FLAT

__all__ = ["CompiledSamples", "load_library", "volumetric_samples"]

Array = np.ndarray
_SOURCES = Path(__file__).with_name("cpu")


def volumetric_samples(law: Law, gradients: Array, weights: Array, mu: Array, lam: Array) -> VolumetricSamples:
    """The samples of a body, see `VolumetricSamples`; those of plain numpy where nothing can be compiled."""
    known = law.name in KERNEL_LAWS and available(load_library)
    return (CompiledSamples if known else VolumetricSamples)(law, gradients, weights, mu, lam)


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
        y, forces = doubles(y), np.empty(y.shape)
        energy = load_library().pc_energy_and_forces(body, address(y), address(forces))
        return energy, forces

    def energy_and_gradient(self, y: Float[Array, "R 3"]) -> tuple[float, Float[Array, "R 3"]]:
        """Elastic energy [J] and its derivative by the coordinates [N]."""
        return self._energy_and_forces(self._body, y)

    def gradient_with(self, y: Float[Array, "R 3"], mu: Array, lam: Array) -> Float[Array, "R 3"]:
        """The derivative [N] with other constants μ and λ [Pa], shape [Q]."""
        mu, lam = doubles(mu), doubles(lam)
        return self._energy_and_forces(self._body_with(mu, lam), y)[1]

    def hessian_blocks(self, y: Float[Array, "R 3"]) -> Float[Array, "3 R 3 R"] | None:
        """Second derivative [N/m], components first; None where the body is nearly flat at a sample."""
        count = len(self._weights)
        y, u, turned = doubles(y), np.empty((count, 3, self._size)), np.empty((count, 2, self._size))
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
        *((name, POINTER) for name in ("blocks", "gradients", "weights", "mu", "lam")),
    )


@cache
def load_library() -> ctypes.CDLL:
    """The library with its functions' types declared.

    Raises:
        KernelUnavailable: no compiler, or it failed.
    """
    body: Any = ctypes.POINTER(_Body)
    functions: Functions = (
        ("pc_lanes", ctypes.c_int32, []),
        ("pc_energy_and_forces", ctypes.c_double, [body, *[POINTER] * 2]),
        ("pc_cofactor_gradients", ctypes.c_int32, [body, *[POINTER] * 3]),
        ("pc_assemble", None, [ctypes.c_int32, *[POINTER] * 4]),
    )
    return loaded(_SOURCES, functions, include=[HEADERS])
