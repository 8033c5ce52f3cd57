"""The compiled arithmetic of a reduced body: its elastic law, its viscosity, and contact of its surface."""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg.blas import dsyrk

from physconvex.dynamics import Contact, obstacle_rows
from physconvex.kernels import POINTER, SOURCES, Kernel, address, aligned, doubles
from physconvex.materials import KERNEL_LAWS, NEARLY_FLAT, Law, MaterialPoints
from physconvex.reduced.volumetric import VolumetricSamples

Array = np.ndarray
_BLOCK = 500_000  # numbers in the rows whose products are summed at once: they fit in the second cache


class _Body(ctypes.Structure):
    """`struct Body` of sources/reduced/kernel.cpp."""

    constants: tuple[Array, Array]  # as long as their addresses

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("samples", "functions", "law")),
        ("flat", ctypes.c_double),
        *((name, POINTER) for name in ("blocks", "gradients", "weights", "mu", "lam")),
    )


class _Surface(ctypes.Structure):
    """`struct Surface` of sources/reduced/kernel.cpp."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("samples", "functions", "obstacles")),
        *((name, POINTER) for name in ("blocks", "areas")),
        *((name, ctypes.c_double) for name in ("stiffness", "smoothing")),
    )


_NUMBER, _INTEGER = ctypes.c_double, ctypes.c_int32
_BODY: Any = ctypes.POINTER(_Body)
REDUCED_KERNEL = Kernel(
    SOURCES / "reduced",
    {
        "pc_lanes": (_INTEGER, []),
        "pc_energy_and_forces": (_NUMBER, [_BODY, *[POINTER] * 2]),
        "pc_viscous_power": (_NUMBER, [_BODY, POINTER, _NUMBER, *[POINTER] * 2]),
        "pc_viscous_tangent": (None, [_BODY, POINTER, _NUMBER, *[POINTER] * 4]),
        "pc_viscous_rows": (None, [_BODY, *[_INTEGER] * 2, POINTER, _NUMBER, POINTER]),
        "pc_surface_contact": (_NUMBER, [ctypes.POINTER(_Surface), *[POINTER] * 3]),
        "pc_mirror": (None, [ctypes.c_size_t, POINTER]),
        "pc_cofactor_gradients": (_INTEGER, [_BODY, *[POINTER] * 3]),
        "pc_assemble": (None, [_INTEGER, *[POINTER] * 4]),
    },
    include=[SOURCES / "shared"],
)


def volumetric_samples(law: Law, points: MaterialPoints) -> VolumetricSamples:
    """The samples of a body, see `VolumetricSamples`; those of plain numpy if nothing can be compiled."""
    return (CompiledSamples if REDUCED_KERNEL.available else VolumetricSamples)(law, points)


def compiled_viscosity(points: MaterialPoints) -> CompiledViscosity | None:
    """The viscosity of a body, see `CompiledViscosity`; None if nothing can be compiled."""
    return CompiledViscosity(points) if REDUCED_KERNEL.available else None


def compiled_surface(contact: Contact, values: Array) -> CompiledSurface | None:
    """A contact law on a surface, see `CompiledSurface`; None if nothing can be compiled."""
    return CompiledSurface(contact, values) if REDUCED_KERNEL.available else None


class CompiledSamples(VolumetricSamples):
    """The same numbers; each energy with its forces reads the gradients once.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """

    def __init__(self, law: Law, points: MaterialPoints) -> None:
        super().__init__(law, points)
        self._compiled = _Compiled(points, law=KERNEL_LAWS.index(law.name))

    def energy_and_gradient(
        self, y: Float[Array, "R 3"], constants: tuple[Array, Array] | None = None
    ) -> tuple[float, Float[Array, "R 3"]]:
        """Elastic energy [J] and its derivative by the coordinates [N], as there."""
        body = self._compiled.body if constants is None else self._compiled.with_constants(*constants)
        y, forces = doubles(y), np.empty(y.shape)
        energy = REDUCED_KERNEL.library.pc_energy_and_forces(body, address(y), address(forces))
        return energy, forces

    def hessian_blocks(self, y: Float[Array, "R 3"]) -> Float[Array, "3 R 3 R"] | None:
        """Second derivative [N/m], components first; None where the body is nearly flat at a sample."""
        count, body = len(self._weights), self._compiled.body
        y, u, turned = doubles(y), np.empty((count, 3, self._size)), np.empty((count, 2, self._size))
        if not REDUCED_KERNEL.library.pc_cofactor_gradients(body, *map(address, (y, u, turned))):
            return super().hessian_blocks(y)
        product = dsyrk(1.0, u.reshape(count, -1).T, lower=1).T  # the upper half
        parts, last = u[:, 0].T @ turned.reshape(count, -1), u[:, 1].T @ turned[:, 1]
        REDUCED_KERNEL.library.pc_assemble(self._size, *map(address, (self._constant, parts, last, product)))
        return product.reshape(3, self._size, 3, self._size)


class CompiledViscosity:
    """Kelvin–Voigt viscosity frozen at F*, see `ReducedBody.viscous_energy_and_gradient`.

    Args:
        points: Q samples.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """

    def __init__(self, points: MaterialPoints) -> None:
        self._compiled = _Compiled(points)

    def energy_and_gradient(
        self,
        state: Float[Array, "Q 3 3"],
        velocity: Float[Array, "R 3"],
        damping_time: float,
        constants: tuple[Array, Array] | None = None,
    ) -> tuple[float, Float[Array, "R 3"]]:
        """Rate potential [W] and its derivative by velocity [N] of viscosities damping_time × (μ, λ).

        `constants` take the place of the body's μ and λ.
        """
        body = self._compiled.body if constants is None else self._compiled.with_constants(*constants)
        state, velocity, forces = doubles(state), doubles(velocity), np.empty(velocity.shape)
        given = body, address(state), damping_time, address(velocity), address(forces)
        return REDUCED_KERNEL.library.pc_viscous_power(*given), forces

    def tangent(
        self,
        state: Float[Array, "Q 3 3"],
        velocity: Float[Array, "R 3"],
        step: Float[Array, "R 3"],
        speed_up: Float[Array, "R 3"],
        damping_time: float,
    ) -> Float[Array, "R 3"]:
        """Derivative of the forces for a change `step` of the coordinates in F*, and `speed_up` of the velocity."""
        forces, given = np.empty(velocity.shape), [doubles(array) for array in (state, velocity, step, speed_up)]
        first, *others = map(address, given)
        REDUCED_KERNEL.library.pc_viscous_tangent(self._compiled.body, first, damping_time, *others, address(forces))
        return forces

    def blocks(self, state: Float[Array, "Q 3 3"], ratio: float) -> Float[Array, "3 R 3 R"]:
        """Stiffness [N/m] of viscosities whose time is `ratio` time steps, components first."""
        state, width, count = doubles(state), 3 * self._compiled.size, len(state)
        most = max(_BLOCK // (6 * width), 1)
        rows, product = np.empty((min(most, count), 6, width)), np.zeros((width, width), order="F")
        for first in range(0, count, most):
            some = rows[: min(most, count - first)]
            REDUCED_KERNEL.library.pc_viscous_rows(
                self._compiled.body, first, len(some), address(state), ratio, address(some)
            )
            product = dsyrk(1.0, some.reshape(-1, width).T, beta=1.0, c=product, lower=1, overwrite_c=1)
        REDUCED_KERNEL.library.pc_mirror(width, address(product.T))
        return product.T.reshape(3, width // 3, 3, width // 3)


class CompiledSurface:
    """A contact law on the samples x_s = Σ_a N_a(s) y_a of a surface, see `SurfaceContact`.

    Args:
        contact: the law, with the areas of the samples.
        values: N_a at the samples, shape [S, R].

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """

    def __init__(self, contact: Contact, values: Float[Array, "S R"]) -> None:
        self._obstacles, self._areas, self._blocks = contact.obstacles, doubles(contact.areas), _in_blocks(values)
        sizes = *values.shape, len(contact.obstacles)
        arrays = address(self._blocks), address(self._areas)
        self._surface = _Surface(*sizes, *arrays, contact.stiffness, contact.smoothing)
        self._time, self._rows = np.nan, np.zeros((0, 9))

    def energy_and_gradient(self, y: Float[Array, "R 3"], time: float) -> tuple[float, Float[Array, "R 3"]]:
        """Contact energy [J] and its derivative [N]."""
        if time != self._time:
            self._time, self._rows = time, obstacle_rows(self._obstacles, time)
        y, forces = doubles(y), np.empty(y.shape)
        energy = REDUCED_KERNEL.library.pc_surface_contact(self._surface, *map(address, (self._rows, y, forces)))
        return energy, forces


def _in_blocks(rows: Float[Array, "Q R ..."]) -> Array:
    """Rows [Q, R, ...] as [⌈Q / lanes⌉, R, ..., lanes], padded with zeros."""
    lanes = REDUCED_KERNEL.library.pc_lanes()
    padded = np.zeros((-(-len(rows) // lanes) * lanes, *rows.shape[1:]))
    padded[: len(rows)] = rows
    return aligned(np.moveaxis(padded.reshape(-1, lanes, *rows.shape[1:]), 1, -1))


class _Compiled:
    """Inputs of the kernel on a body's interior."""

    def __init__(self, points: MaterialPoints, law: int = 0) -> None:
        self.size, self._law = points.gradients.shape[2], law
        arrays = (points.gradients, points.weights, points.mu, points.lam)
        self._gradients, self._weights, self._mu, self._lam = map(doubles, arrays)
        self._blocks = _in_blocks(self._gradients.transpose(0, 2, 1))

    def __getstate__(self) -> dict[str, Any]:
        """Without addresses, which are invalid in another process."""
        return {name: value for name, value in self.__dict__.items() if name != "body"}

    @cached_property
    def body(self) -> _Body:
        return self.with_constants(self._mu, self._lam)

    def with_constants(self, mu: Float[Array, " Q"], lam: Float[Array, " Q"]) -> _Body:
        """With other constants."""
        mu, lam = doubles(mu), doubles(lam)
        arrays = (self._blocks, self._gradients, self._weights, mu, lam)
        body = _Body(len(self._weights), self.size, self._law, NEARLY_FLAT, *map(address, arrays))
        body.constants = mu, lam
        return body
