"""Derivative of a loss by the density of each cell.

A step's gradient is linear in the density: ∫ ρ N_a (pull − g) dV with the acceleration field pull − g. A sweep
accumulates its products with the derivative λ of the loss by the gradient in one matrix [R, R]. The cells are separated
at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.reduced.body import ReducedBody

_BLOCK = 20_000


@dataclass(frozen=True)
class DensityGradient:
    """Data on the densities from a backward sweep.

    Attributes:
        body: the body.
        products: Σ λ_a · (pull − g)_b over all solves, shape [R, R].
        start: coordinates at t = 0 [m], shape [R, 3].
        center: derivative of the loss by the centre of the initial rotation [1/m], shape [3].
    """

    body: ReducedBody
    products: Float[np.ndarray, "R R"]
    start: Float[np.ndarray, "R 3"]
    center: Float[np.ndarray, " 3"]

    def by_cell(self) -> Float[np.ndarray, " C"]:
        """Derivative by ρ of each cell [m³/kg], shape [C]."""
        space, total = self.body.space, self.body.total_mass
        mass = space.samples.mass
        center = self.body.first_moments @ self.start / total
        out = np.zeros(mass.cell_count)
        for rows in np.array_split(np.arange(len(mass.points)), 1 + len(mass.points) // _BLOCK):
            values = space.shape_values(mass.points[rows])
            shares = np.einsum("qa,ab,qb->q", values, self.products, values, optimize=True)
            shares += (values @ self.start - center) @ self.center / total
            np.add.at(out, mass.cells[rows], mass.weights[rows] * shares)
        return out
