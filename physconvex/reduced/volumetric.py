"""Fast arithmetic for the laws of `physconvex.materials.volumetric` in a reduced space, float64 on the CPU.

With C = cof F, the stress is P = μ F + f' C, and with u_i = Σ_j C_ij ∂N/∂X_j ∈ R^R the integrated Hessian has the
blocks

    H_ik = δ_ik Σ w μ ∂N·∂Nᵀ + Σ w f'' u_i u_kᵀ + Σ w f'/J (u_i u_kᵀ − u_k u_iᵀ)

(the last term is f' ∂C/∂F, because row b of F is the cross product of the other two rows of C over J). The first term
is constant, the second one symmetric product [3R, Q]·[Q, 3R], the third three products [R, Q]·[Q, R]: 15 R² Q
operations in all, against 36 R² Q of a general law.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float

from physconvex.materials import (
    Law,
    MaterialPoints,
    cofactor_and_determinant,
    energy_and_stress,
    nearly_flat,
    slopes_of_volume,
)

Array = np.ndarray


class VolumetricSamples:
    """The samples of a body of such a law.

    Args:
        law: one with a `volumetric` part.
        points: Q samples.
    """

    def __init__(self, law: Law, points: MaterialPoints) -> None:
        assert law.volumetric is not None
        count, _, size = points.gradients.shape
        self._part, self._size = law.volumetric, size
        arrays = (points.gradients, points.weights, points.mu, points.lam)
        self._gradients, self._weights, self._mu, self._lam = map(np.ascontiguousarray, arrays)
        flat = self._gradients.reshape(3 * count, size)
        self._constant = flat.T @ (np.repeat(self._weights * self._mu, 3)[:, None] * flat)

    @cached_property
    def _by_function(self) -> Float[Array, "R 3Q"]:
        return np.ascontiguousarray(self._gradients.transpose(2, 1, 0).reshape(self._size, -1))

    def _deformation_gradient(self, y: Float[Array, "R 3"]) -> Float[Array, "3 3 Q"]:
        """F at the samples."""
        # three matrix–vector products: for a matrix of three columns BLAS first copies the whole matrix
        f = np.empty((3, 3, len(self._weights)))
        for column, row in zip(y.T, f.reshape(3, -1), strict=True):
            np.matmul(column, self._by_function, out=row)
        return f

    @np.errstate(over="ignore", invalid="ignore")  # a far too long trial step has no finite energy, and is rejected
    def energy_and_gradient(
        self, y: Float[Array, "R 3"], constants: tuple[Array, Array] | None = None
    ) -> tuple[float, Float[Array, "R 3"]]:
        """Elastic energy [J] and its derivative by the coordinates [N].

        Args:
            y: coordinates [m].
            constants: μ and λ [Pa], shape [Q], in place of the body's.
        """
        mu, lam = constants or (self._mu, self._lam)
        energy, stress = energy_and_stress(self._part, self._deformation_gradient(y), self._weights, mu, lam)
        return energy, self._forces(stress)

    def _forces(self, stress: Float[Array, "3 3 Q"]) -> Float[Array, "R 3"]:
        """Of stresses times the weights."""
        return np.stack([self._by_function @ row for row in stress.reshape(3, -1)], axis=1)

    def hessian_blocks(self, y: Float[Array, "R 3"]) -> Float[Array, "3 R 3 R"] | None:
        """Second derivative [N/m], components first; None where the body is nearly flat at a sample."""
        cofactor, j = cofactor_and_determinant(self._deformation_gradient(y))
        if nearly_flat(cofactor, j):
            return None
        _, slope, curvature = slopes_of_volume(self._part, j, self._mu, self._lam)
        first = self._weights * curvature
        convex = bool((first > 0).all())
        scale = first if convex else np.ones_like(j)
        cofactor *= np.sqrt(scale)
        u = np.matmul(cofactor.transpose(2, 0, 1).copy(), self._gradients)  # √scale u_i, [Q, i, R]
        flat = u.reshape(len(j), -1)
        # numpy uses the symmetric product for Aᵀ A, at half the cost
        product = flat.T @ flat if convex else flat.T @ (flat * first[:, None])
        size = self._size
        blocks = product.reshape(3, size, 3, size)
        turned = u[:, 1:] * (self._weights * slope / (j * scale))[:, None, None]
        parts = u[:, 0].T @ turned.reshape(len(u), 2 * size)
        for i, k, part in ((0, 1, parts[:, :size]), (0, 2, parts[:, size:]), (1, 2, u[:, 1].T @ turned[:, 1])):
            skew = part - part.T
            blocks[i, :, k] += skew
            blocks[k, :, i] -= skew
        for i in range(3):
            blocks[i, :, i] += self._constant
        return blocks
