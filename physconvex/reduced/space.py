"""The reduced space: motions φ(X) = X + Σ_m W_m(X) Z_m [X; 1] in well-conditioned coordinates.

The functions W_m(X) [ξ; 1]_k, ξ = (X − centre)/size, are 4 (M + 1) scalar shape functions shared by the three
coordinates, so that φ = Σ_a N_a(X) y_a with y_a ∈ R³: the reduced body is one element with global shape functions.
Products of weights with X are nearly dependent (the first mode of a bar is almost X itself). The N_a are therefore
orthogonalised in order, ∫ N_a N_b dV = V δ_ab, so that the coordinates y are metres of rms displacement, and dependent
functions are left out. The constant weight comes first: affine motions are exact.

A weight that varies within an element, times ξ, has a higher degree than the element, and the quadrature of the
element's own energy underestimates that of the product: rough weights make a body too soft. If the products are
interpolated at the nodes of the weights' mesh, they lie in the space of the full model on that mesh, are integrated as
accurately as there, and converge to it from the stiff side. φ then equals the formula at the nodes.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.reduced.basis import NodalFunctions, NodalWeights, WeightField, checked_points, sample_basis
from physconvex.reduced.cubature import BodySamples, Cubature

_DEPENDENT = 1e-9  # share of a function's square norm below which it counts as a combination of those before it
_BLOCK = 20_000


def _ordered_orthogonal(gram: np.ndarray, volume: float) -> np.ndarray:
    """Columns T with Tᵀ G T = V·1 that span what the functions span, in their order (Gram–Schmidt), [D, R]."""
    basis = np.zeros((len(gram), 0))
    for j in range(len(gram)):
        residual = np.eye(len(gram))[j]
        for _ in range(2):  # the second pass removes rounding errors
            residual = residual - basis @ (basis.T @ (gram @ residual)) / volume
        square = residual @ gram @ residual
        if square > _DEPENDENT * gram[j, j]:
            basis = np.column_stack([basis, residual * np.sqrt(volume / square)])
    return basis


class ReducedSpace:
    """Shape functions of a reduced body, and their values where the body is sampled.

    Args:
        field: skinning weights.
        samples: where the body is sampled.
        interpolated: whether the products W_m ξ_k are interpolated at the nodes of the weights' mesh (see above).

    Attributes:
        interior_gradients: ∂N_a/∂X at the interior samples [1/m], shape [Q, R, 3].
        surface_values: N_a at the surface samples, shape [S, R].
        integrals: ∫ N_a dV [m³], shape [R].
        rest: coordinates of the rest state [m], shape [R, 3].

    Raises:
        InputError: the samples are too few or too flat to distinguish affine motions; `interpolated` weights without a
        mesh.
    """

    def __init__(self, field: WeightField, samples: BodySamples, *, interpolated: bool = False) -> None:
        self.field, self.samples = field, samples
        self._nodal: NodalFunctions | None = None
        mass = samples.mass
        self._center = mass.weights @ mass.points / mass.volume
        self._length = samples.size
        self._slopes = np.vstack([np.eye(3) / self._length, np.zeros((1, 3))])  # of [ξ; 1]
        if interpolated:
            self._nodal = self._products(field)
        self._gram, integrals = self._moments(np.ones(mass.cell_count))
        self._transform = _ordered_orthogonal(self._gram, mass.volume)
        if self.dimension < 4 or not np.all(self._transform[:4, :4].diagonal() > 0):  # an affine function is missing
            raise InputError("samples: they lie in a plane or are fewer than four; expected a solid body")
        self.integrals = self._transform.T @ integrals
        self.interior_gradients = self.shape_gradients(samples.interior.points)
        self.surface_values = self.shape_values(samples.surface_points)
        self.rest = self.affine(np.eye(3), np.zeros(3))

    @property
    def dimension(self) -> int:
        """R, number of shape functions; the body has 3 R degrees of freedom."""
        return self._transform.shape[1]

    # -- raw functions W_m [ξ; 1]_k, ordered by m, then k

    def _products(self, field: WeightField) -> NodalFunctions:
        """The raw functions at the nodes."""
        if not isinstance(field, NodalWeights):
            raise InputError(
                f"interpolated: got weights of the kind {type(field).__name__}; expected weights at the nodes of a "
                "mesh, such as `eigenmode_weights` and `elastic_weights` give"
            )
        nodes = field.mesh.vertices
        weights = np.hstack([np.ones((len(nodes), 1)), field.nodal_values])
        return NodalFunctions(field.mesh, self._times_position(nodes, weights))

    def _homogeneous(self, points: np.ndarray) -> np.ndarray:
        """[ξ; 1], shape [P, 4]."""
        return np.hstack([(points - self._center) / self._length, np.ones((len(points), 1))])

    def _times_position(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        raw = weights[:, :, None] * self._homogeneous(points)[:, None, :]
        return raw.reshape(len(points), 4 * weights.shape[1])

    def _raw_values(self, points: np.ndarray) -> np.ndarray:
        if self._nodal is not None:
            return self._nodal.at(checked_points(points))[0]
        basis = sample_basis(self.field, points)
        return self._times_position(basis.points, basis.values)

    def _raw_gradients(self, points: np.ndarray) -> np.ndarray:
        if self._nodal is not None:
            return self._nodal.at(checked_points(points))[1]
        basis = sample_basis(self.field, points)
        raw = basis.gradients[:, :, None, :] * self._homogeneous(basis.points)[:, None, :, None]
        raw = raw + basis.values[:, :, None, None] * self._slopes
        return raw.reshape(len(points), 4 * basis.values.shape[1], 3)

    def _moments(self, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∫ ρ N_a N_b and ∫ ρ N_a of the raw functions, for a density per cell."""
        mass: Cubature = self.samples.mass
        size = 4 * (self.field.count + 1)
        gram, integrals = np.zeros((size, size)), np.zeros(size)
        for rows in np.array_split(np.arange(len(mass.points)), 1 + len(mass.points) // _BLOCK):
            values = self._raw_values(mass.points[rows])
            weighted = values * (mass.weights[rows] * density[mass.cells[rows]])[:, None]
            gram += values.T @ weighted
            integrals += weighted.sum(0)
        return gram, integrals

    # -- shape functions

    def shape_values(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P R"]:
        """N_a at rest positions [m]: positions of the points are `shape_values(points) @ y`."""
        return self._raw_values(points) @ self._transform

    def shape_values_of(
        self, points: Float[np.ndarray, "P 3"], weights: Float[np.ndarray, "P M"]
    ) -> Float[np.ndarray, "P R"]:
        """N_a at rest positions [m] from the weights there, which are known already."""
        return self._times_position(points, np.hstack([np.ones((len(points), 1)), weights])) @ self._transform

    def shape_gradients(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P R 3"]:
        """∂N_a/∂X at rest positions [1/m]."""
        raw = self._raw_gradients(points)
        return np.einsum("pdi,dr->pri", raw, self._transform)

    def weights_of_values(
        self, points: Float[np.ndarray, "P 3"], derivatives: Float[np.ndarray, "P R"]
    ) -> Float[np.ndarray, "P M"]:
        """Derivatives of a function by W_m from those by N_a at rest positions [m]; the basis of the space is kept."""
        raw = (derivatives @ self._transform.T).reshape(len(points), self.field.count + 1, 4)[:, 1:]
        return np.einsum("pmk,pk->pm", raw, self._homogeneous(points))

    def weights_of_gradients(
        self, points: Float[np.ndarray, "P 3"], derivatives: Float[np.ndarray, "P R 3"]
    ) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "P M 3"]]:
        """Derivatives of a function by W_m and by ∂W_m/∂X [m] from those by ∂N_a/∂X [m] at rest positions [m]."""
        raw = np.einsum("pri,dr->pdi", derivatives, self._transform)
        raw = raw.reshape(len(points), self.field.count + 1, 4, 3)[:, 1:]
        values = np.einsum("pmki,ki->pm", raw, self._slopes)
        return values, np.einsum("pmki,pk->pmi", raw, self._homogeneous(points))

    def mass_matrix(self, density: Float[np.ndarray, " C"]) -> tuple[Float[np.ndarray, "R R"], Float[np.ndarray, " R"]]:
        """∫ ρ N_a N_b dV and ∫ ρ N_a dV [kg] for a density per cell [kg/m³]."""
        if np.ptp(density) == 0:
            gram, integrals = density[0] * self._gram, density[0] * self.integrals
            return self._transform.T @ gram @ self._transform, integrals
        gram, raw = self._moments(density)
        return self._transform.T @ gram @ self._transform, self._transform.T @ raw

    # -- coordinates

    def affine(self, linear: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "R 3"]:
        """Coordinates of the field X ↦ linear X + shift (a position or a velocity)."""
        raw = np.vstack([self._length * np.asarray(linear).T, np.asarray(shift) + np.asarray(linear) @ self._center])
        coordinates = np.zeros((self.dimension, 3))
        coordinates[:4] = np.linalg.solve(self._transform[:4, :4], raw)
        return coordinates

    def handles(self, coordinates: Float[np.ndarray, "*B R 3"]) -> Float[np.ndarray, "*B K 3 4"]:
        """Z_m of φ(X) = X + Σ_m W_m(X) Z_m [X; 1], the constant weight first; zero at rest."""
        raw = np.moveaxis(self._transform @ (np.asarray(coordinates) - self.rest), -2, -1)  # [..., 3, 4 K]
        raw = np.moveaxis(raw.reshape(*raw.shape[:-1], -1, 4), -2, -3)  # [..., K, 3, 4]
        linear = raw[..., :3] / self._length
        return np.concatenate([linear, raw[..., 3:] - linear @ self._center[:, None]], axis=-1)
