"""Derivatives of a loss by a body's skinning weights and densities: by W_m and ∂W_m/∂X at all samples of the body.

The gradient g of a step's potential contains the shape functions N_a of `physconvex.reduced.space` at four kinds of
points: their slopes at the samples of the elastic energy, their values on the surface, at pins and at the samples of
the mass. With λ the derivative of the loss by g, each term of λ·g is a function of fields A = Σ_a N_a a_a (or F = Σ_a
a_a ⊗ ∂N_a/∂X) of some coordinates a, and ∂(λ·g)/∂N_a = Σ (∂(λ·g)/∂A) · a_a over these fields. These derivatives are
mapped to the weights with the transformation of the space held fixed: neither a motion nor the affine start depends on
the basis of the space.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from physconvex.materials import viscous_stress
from physconvex.reduced.body import ReducedBody
from physconvex.reduced.equations import ReducedEquations
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.surface_contact import contact_blocks

_BLOCK = 20_000  # points of the mass at once


def density_gradient(
    body: ReducedBody,
    products: Float[np.ndarray, "R R"],
    start: Float[np.ndarray, "R 3"],
    center: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, " C"]:
    """Derivative of a loss by ρ of each cell [m³/kg].

    A step's gradient is linear in the density: ∫ ρ N_a (pull − g) dV with the acceleration field pull − g.

    Args:
        body: the body.
        products: Σ λ_a · (pull − g)_b over all solves, λ the derivative of the loss by the gradient.
        start: coordinates at t = 0 [m].
        center: derivative of the loss by the centre of the initial rotation [1/m].
    """
    mass, total = body.space.samples.mass, body.total_mass
    middle = body.first_moments @ start / total
    out = np.zeros(mass.cell_count)
    for rows in np.array_split(np.arange(len(mass.points)), 1 + len(mass.points) // _BLOCK):
        values = body.space.shape_values(mass.points[rows])
        shares = np.einsum("qa,ab,qb->q", values, products, values, optimize=True)
        shares += (values @ start - middle) @ center / total
        np.add.at(out, mass.cells[rows], mass.weights[rows] * shares)
    return out


class FieldBars:
    """Derivatives of a loss by the shape functions, accumulated during a backward sweep.

    Args:
        scene: of the roll-out; its body is elastic or damped.
    """

    def __init__(self, scene: ReducedScene) -> None:
        self.scene, self.body = scene, scene.body
        space = scene.body.space
        self._interior = np.zeros((3 * len(space.interior_gradients), space.dimension))  # [(Q, j), R]
        self._surface = np.zeros_like(space.surface_values)
        self._pins = np.zeros((0 if scene.pins is None else len(scene.pins.points), space.dimension))
        self._loads = np.zeros((0 if scene.loads is None else len(scene.loads.points), space.dimension))
        self._weights = torch.as_tensor(space.samples.interior.weights, device=scene.body.device)

    def add_solve(
        self,
        equations: ReducedEquations,
        x: Float[np.ndarray, "R 3"],
        velocity: Float[np.ndarray, "R 3"],
        guess: Float[np.ndarray, "R 3"],
        force_bar: Float[np.ndarray, "R 3"],
    ) -> None:
        """The gradient of one solve at coordinates x [m], without inertia and the dependence of frozen friction.

        Args:
            equations: of its step, with its friction.
            x: the solution.
            velocity: of the coordinates there [m/s].
            guess: coordinates at which viscosity is frozen [m].
            force_bar: λ.
        """
        self._add_stress(x, guess, velocity, force_bar)
        self._add_contact(equations, x, velocity, force_bar)
        if equations.pins is not None:
            lever = equations.pins.weights[:, None] * (equations.pins.values @ force_bar)
            self._pins += lever @ x.T - equations.pins.pull(x, equations.time) @ force_bar.T
        if self.scene.loads is not None:
            self._loads -= self.scene.loads.at(equations.time) @ force_bar.T

    def add_surface(self, bar: Float[np.ndarray, "S 3"], coordinates: Float[np.ndarray, "R 3"]) -> None:
        """The derivative `bar` by a field on the surface that has these coordinates."""
        self._surface += bar @ coordinates.T

    def _add_stress(self, x: np.ndarray, guess: np.ndarray, velocity: np.ndarray, force_bar: np.ndarray) -> None:
        body, beta, fields = self.body, self.scene.damping_time, (x, guess, velocity, force_bar)
        with torch.enable_grad():
            leaves = [body.deformation_gradient(field).clone().requires_grad_() for field in fields]
            f, state, rate, spread = leaves
            stress = body.law.stress(f, body.mu, body.lam) + viscous_stress(
                state, rate, beta * body.mu, beta * body.lam
            )
            bars = torch.autograd.grad((self._weights * (stress * spread).sum((-1, -2))).sum(), leaves)
        for bar, field in zip(bars, fields, strict=True):
            self._interior += bar.mT.reshape(-1, 3).cpu().numpy() @ field.T

    def _add_contact(
        self, equations: ReducedEquations, x: np.ndarray, velocity: np.ndarray, force_bar: np.ndarray
    ) -> None:
        """Contact, wind, and frozen friction, which is linear in the velocities."""
        at, spread = equations.surface @ x, equations.surface @ force_bar
        _, force = equations.contact.energy_and_gradient(at, equations.time)
        blocks = contact_blocks(equations.contact, at, equations.time)
        self.add_surface((blocks @ spread[:, :, None])[:, :, 0], x)
        if self.scene.wind is not None:
            speeds = equations.surface @ velocity
            force = force + self.scene.wind.energy_and_gradient(speeds, equations.areas, equations.time)[1]
            self.add_surface((equations.wind_blocks(velocity) @ spread[:, :, None])[:, :, 0], velocity)
        for part in equations.friction:
            np.add.at(force, part.nodes, part.weights[:, None] * part.slip(equations.surface @ velocity))
        self.add_surface(force, force_bar)

    def finish(self, products: Float[np.ndarray, "R R"]) -> tuple[Float[np.ndarray, "P M"], Float[np.ndarray, "Q M 3"]]:
        """By the weights, at the end of the sweep.

        Args:
            products: Σ λ_a · (pull − g)_b over all solves.

        Returns:
            derivatives by W_m at the interior samples, the surface samples, the points at which the mass is integrated,
            the pins and the points of the loads, and by ∂W_m/∂X at the interior samples [m].
        """
        space, mass = self.body.space, self.body.space.samples.mass
        density = mass.weights * self.body.density[mass.cells]
        heavier = density[:, None] * (space.shape_values(mass.points) @ (products + products.T))
        by_gradients = self._interior.reshape(-1, 3, space.dimension).transpose(0, 2, 1)
        interior, slopes = space.weights_of_gradients(space.samples.interior.points, by_gradients)
        none = np.zeros((0, 3))
        by_values = (
            (space.samples.surface_points, self._surface),
            (mass.points, heavier),
            (none if self.scene.pins is None else self.scene.pins.points, self._pins),
            (none if self.scene.loads is None else self.scene.loads.points, self._loads),
        )
        return np.concatenate([interior, *(space.weights_of_values(*pair) for pair in by_values)]), slopes
