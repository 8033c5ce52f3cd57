"""Cubature with few points: non-negative weights that reproduce the elastic forces of training deformations.

After An, Kim and James 2008 ("Optimizing cubature for efficient integration of subspace deformations"): the generalised
forces of a state are a sum over the points of all tetrahedra, Σ_q w_q f_q; fewer points with other weights w ≥ 0 are
sought that give the same sums for many states at once. Non-negative least squares by Lawson and Hanson's active set
(1974), on the normal equations; the volume is one more equation.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from physconvex.errors import InputError
from physconvex.reduced.body import ReducedBody
from physconvex.reduced.cubature import Cubature

__all__ = ["nonnegative_least_squares", "optimised_cubature"]

_STRAIN = 0.08  # rms of F − I in the training states
_VOLUME_WEIGHT = 1.0  # of the equation of the volume, the forces of a state counting one


def _training_state(body: ReducedBody, generator: np.random.Generator) -> Float[np.ndarray, "R 3"]:
    """A random deformation: higher functions, which are rougher, by smaller amplitudes."""
    rough = np.sqrt(np.einsum("qrj,qrj->r", body.space.interior_gradients, body.space.interior_gradients))
    change = generator.normal(size=body.rest.shape) / np.maximum(rough, rough[rough > 0].min())[:, None]
    bent = body.deformation_gradient(change)
    size = float(torch.sqrt((bent**2).sum((-1, -2)).mean()))
    return body.rest + generator.uniform(0.2, 1.5) * _STRAIN / size * change


def _forces_by_point(body: ReducedBody, y: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "Q N"]:
    """Generalised forces per volume at each sample, relative to those of the whole body."""
    stress = body.law.stress(body.deformation_gradient(y), body.mu, body.lam).cpu().numpy()
    forces = np.einsum("qij,qrj->qri", stress, body.space.interior_gradients).reshape(len(stress), -1)
    return forces / np.linalg.norm(body.space.samples.interior.weights @ forces)


def nonnegative_least_squares(
    gram: Float[np.ndarray, "Q Q"], right: Float[np.ndarray, " Q"], *, most: int, tolerance: float
) -> Float[np.ndarray, " Q"]:
    """w ≥ 0 that minimises ½ wᵀ G w − rᵀ w with at most `most` weights above zero.

    Args:
        gram: AᵀA.
        right: Aᵀ b.
        most: bound on the number of weights.
        tolerance: the search ends where no gradient exceeds this share of the largest one at the start.
    """
    w, active = np.zeros(len(right)), np.zeros(len(right), dtype=bool)
    stop = tolerance * np.abs(right).max()
    while active.sum() < most:
        slope = np.where(active, -np.inf, right - gram @ w)
        chosen = int(slope.argmax())
        if slope[chosen] <= stop:
            break
        active[chosen] = True
        while True:
            inner = np.flatnonzero(active)
            block = gram[np.ix_(inner, inner)]
            block.flat[:: len(inner) + 1] *= 1 + 1e-12
            best = cho_solve(cho_factor(block), right[inner])
            if (best > 0).all():
                w[inner] = best
                break
            falling = best <= 0  # go as far as the first weight that vanishes, and drop it
            share = (w[inner] / np.maximum(w[inner] - best, 1e-300))[falling].min()
            w[inner] += share * (best - w[inner])
            gone = inner[falling & (w[inner] <= 1e-14 * w.max(initial=1e-300))]
            active[gone if len(gone) else inner[best.argmin()]] = False
            w[~active] = 0.0
    return w


def optimised_cubature(
    body: ReducedBody,
    points: int = 300,
    *,
    generator: np.random.Generator,
    states: int = 40,
    tolerance: float = 1e-6,
) -> Cubature:
    """Fewer interior samples for a body, fitted to forces of random deformations.

    Use it as `ReducedSpace(field, dataclasses.replace(samples, interior=optimised_cubature(body, ...)))`. About seven
    points per shape function leave the stiffness of every mode within a few per cent.

    Args:
        body: with all its samples; elastic.
        points: most points to keep.
        generator: draws the deformations.
        states: number of training deformations.
        tolerance: the search ends earlier where no point would improve the fit by this share.

    Returns:
        Points, positive weights and cells; the sum of the weights is the volume of the body.

    Raises:
        InputError: a body that flows, or fewer than one point or state.
    """
    if body.flow is not None:
        raise InputError(f"body: it flows ({body.flow}); make the cubature of the elastic body without `flow`")
    if points < 1 or states < 1:
        raise InputError(f"points, states: got {points}, {states}; expected at least 1")
    interior = body.space.samples.interior
    count = len(interior.weights)
    gram, right = np.zeros((count, count)), np.zeros(count)
    for _ in range(states):
        forces = _forces_by_point(body, _training_state(body, generator))
        gram += forces @ forces.T / states
        right += forces @ (interior.weights @ forces) / states
    unit = _VOLUME_WEIGHT / interior.volume
    gram, right = gram + unit**2, right + unit**2 * interior.volume
    # weights relative to the present ones: all of a size
    scaled = gram * interior.weights[:, None] * interior.weights
    found = nonnegative_least_squares(scaled, right * interior.weights, most=points, tolerance=tolerance)
    kept = np.flatnonzero(found)
    weights = found[kept] * interior.weights[kept]
    weights *= interior.volume / weights.sum()
    return Cubature(interior.points[kept], weights, interior.cells[kept], interior.cell_count)
