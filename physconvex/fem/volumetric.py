"""Fast arithmetic on the CPU for the laws of `physconvex.materials.volumetric` on tetrahedra, with viscosity.

Arrays hold one component each, over all quadrature points p: F [i, j, p]. F and nodal forces come from one sparse
matrix, ∂N_a/∂X_j at the points. With C = cof F and u_ai = Σ_j C_ij ∂N_a/∂X_j, the stiffness of an element is

    H_aibk = δ_ik Σ w μ ∂N_a·∂N_b + Σ w f'' u_ai u_bk + Σ w f'/J (u_ai u_bk − u_ak u_bi)

(see `physconvex.reduced.volumetric`), and with v_ai = Σ_j F*_ij ∂N_a/∂X_j that of the viscosity of a step

    Σ w λ_v v_ai v_bk + Σ w μ_v v_ak v_bi + Σ w μ_v (F* F*ᵀ)_ik ∂N_a·∂N_b.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.materials import (
    Law,
    MaterialPoints,
    cofactor_and_determinant,
    energy_and_stress,
    nearly_flat,
    slopes_of_volume,
)

Array = np.ndarray
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True)
class StepViscosity:
    """Kelvin–Voigt viscosity during a time step.

    Attributes:
        state: F* at which it is frozen, shape [E, Q, 3, 3].
        damping_time: viscosities over Lamé constants [s].
        step: derivative of positions by velocities [s].
    """

    state: Tensor
    damping_time: float
    step: float

    @property
    def ratio(self) -> float:
        """Damping time over the time step [-]."""
        return self.damping_time / self.step


class VolumetricElements:
    """The quadrature points of a body of such a law.

    Args:
        law: one with a `volumetric` part.
        tets: node indices, shape [E, n].
        count: V, number of nodes.
        points: Q of each element.
    """

    def __init__(self, law: Law, tets: Int[Array, "E n"], count: int, points: MaterialPoints) -> None:
        assert law.volumetric is not None
        self._term, self._shape = law.volumetric, points.gradients.shape
        self._gradients = np.ascontiguousarray(points.gradients)
        self._weights = points.weights.ravel()
        self._mu, self._lam = points.mu.ravel(), points.lam.ravel()
        self._weighted_mu, self._weighted_lam = self._weights * self._mu, self._weights * self._lam
        self._tets, self._count = tets, count

    @cached_property
    def _to_points(self) -> sp.csr_matrix:
        """∂/∂X at the points from values at the nodes, rows (j, p)."""
        points = np.arange(self._weights.size).reshape(*self._shape[:2], 1, 1)
        rows = np.broadcast_to(np.arange(3) * self._weights.size + points, self._shape)
        columns = np.broadcast_to(self._tets[:, None, :, None], self._shape)
        entries = self._gradients.ravel(), (rows.ravel(), columns.ravel())
        return sp.csr_matrix(entries, shape=(3 * self._weights.size, self._count))

    @cached_property
    def _to_nodes(self) -> sp.csr_matrix:
        return self._to_points.T.tocsr()

    @cached_property
    def _by_axis(self) -> Float[Array, "E Q 3 n"]:
        return np.ascontiguousarray(self._gradients.transpose(0, 1, 3, 2))

    @cached_property
    def _constant(self) -> Float[Array, "E n n"]:
        return self._dots(self._weighted_mu.reshape(self._shape[:2]))

    def _at_points(self, x: Float[Array, "V m"]) -> Float[Array, "m 3 P"]:
        """∂x/∂X of m fields, field by field."""
        return np.ascontiguousarray((self._to_points @ x).reshape(3, -1, x.shape[1]).transpose(2, 0, 1))

    def _forces(self, stress: Float[Array, "3 3 P"]) -> Float[Array, "V 3"]:
        """∫ P : ∂N_a/∂X dV [N] of a stress times the weights."""
        return self._to_nodes @ stress.transpose(1, 2, 0).reshape(-1, 3)

    def _elastic(self, f: Float[Array, "3 3 P"], *, with_energy: bool) -> tuple[float, Float[Array, "3 3 P"]]:
        """Energy [J] (NaN without), and stress times the weights; overwrites F."""
        return energy_and_stress(self._term, f, self._weights, self._mu, self._lam, with_energy=with_energy)

    def energy_and_gradient(self, x: Float[Array, "V 3"]) -> tuple[float, Float[Array, "V 3"]]:
        """Elastic energy [J] and its derivative by the positions of the nodes [N]."""
        energy, stress = self._elastic(self._at_points(x), with_energy=True)
        return energy, self._forces(stress)

    def moving_energy_and_gradient(
        self, x: Float[Array, "V 3"], velocity: Float[Array, "V 3"], viscosity: StepViscosity, *, with_energy: bool
    ) -> tuple[float, Float[Array, "V 3"]]:
        """The same with the viscosity of a step, as `ElasticBody.moving_energy_and_gradient`."""
        both = self._at_points(np.concatenate([x, velocity], axis=1))
        damping_time = viscosity.damping_time
        frozen = np.ascontiguousarray(viscosity.state.numpy().reshape(-1, 3, 3).transpose(1, 2, 0))
        strain = np.einsum("ijp,ikp->jkp", frozen, both[3:])
        strain = 0.5 * (strain + strain.transpose(1, 0, 2))
        inner = 2 * damping_time * self._weighted_mu * strain
        trace = damping_time * self._weighted_lam * np.einsum("jjp->p", strain)
        for j in range(3):
            inner[j, j] += trace
        energy, stress = self._elastic(both[:3], with_energy=with_energy)
        stress += np.einsum("ijp,jkp->ikp", frozen, inner)
        return energy + 0.5 * viscosity.step * float(np.einsum("jkp,jkp->", inner, strain)), self._forces(stress)

    def stiffness(
        self,
        x: Float[Array, "V 3"],
        *,
        viscosity: StepViscosity | None = None,
        out: Float[Array, "E m m"] | None = None,
    ) -> Float[Array, "E m m"] | None:
        """Element matrices as `ElasticBody.element_hessians`; None where the body is nearly flat at a point."""
        cofactor, j = cofactor_and_determinant(self._at_points(x))
        if nearly_flat(cofactor, j):
            return None
        _, slope, curvature = slopes_of_volume(self._term, j, self._mu, self._lam)
        elastic = _Fields(self._along(cofactor.transpose(2, 1, 0)), self._weights * slope / j)
        out = self._squares(elastic.values, self._weights * curvature, out)
        viscous = None
        if viscosity is not None:
            state, ratio = viscosity.state.numpy(), viscosity.ratio
            viscous = _Fields(self._along(state.transpose(0, 1, 3, 2)), ratio * self._weighted_mu)
            out += self._squares(viscous.values, ratio * self._weighted_lam)
            squared = state @ state.transpose(0, 1, 3, 2) * viscous.weights[..., None]
        count, _, nodes, _ = self._shape
        blocks = out.reshape(count, nodes, 3, nodes, 3)
        for i, k in _PAIRS:
            part = self._constant
            if i < k:
                part = elastic.product(i, k)
                part = part - part.transpose(0, 2, 1)
            if viscous is not None:
                part = part + viscous.product(k, i) + self._dots(squared[:, :, i, k])
            blocks[:, :, i, :, k] += part
            if i < k:
                blocks[:, :, k, :, i] += part.transpose(0, 2, 1)
        return out

    def _along(self, matrices: Array) -> Float[Array, "E Q n 3"]:
        """Σ_j A_ij ∂N_a/∂X_j from Aᵀ at the points."""
        return self._gradients @ np.ascontiguousarray(matrices).reshape(*self._shape[:2], 3, 3)

    def _squares(
        self, fields: Float[Array, "E Q n 3"], weights: Float[Array, " P"], out: Float[Array, "E m m"] | None = None
    ) -> Float[Array, "E m m"]:
        """Σ_q w u_ai u_bk."""
        flat = fields.reshape(*self._shape[:2], -1)
        return np.matmul((flat * weights.reshape(*self._shape[:2], 1)).transpose(0, 2, 1), flat, out=out)

    def _dots(self, weights: Float[Array, "E Q"]) -> Float[Array, "E n n"]:
        """Σ_q w ∂N_a·∂N_b."""
        count, points, nodes, _ = self._shape
        weighted = (weights[..., None, None] * self._by_axis).reshape(count, points * 3, nodes)
        return weighted.transpose(0, 2, 1) @ self._by_axis.reshape(count, points * 3, nodes)


class _Fields:
    """u_ai at the points, and weights of their products."""

    def __init__(self, values: Float[Array, "E Q n 3"], weights: Float[Array, " P"]) -> None:
        self.values, self.weights = values, weights.reshape(*values.shape[:2], 1)
        self._components = np.ascontiguousarray(values.transpose(3, 0, 1, 2))
        self._weighted = self._components * self.weights

    def product(self, i: int, k: int) -> Float[Array, "E n n"]:
        """Σ_q w u_ai u_bk."""
        return self._weighted[i].transpose(0, 2, 1) @ self._components[k]
