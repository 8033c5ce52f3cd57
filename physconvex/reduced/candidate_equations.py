"""The incremental potentials of one time step for B candidates at once, in torch on any device.

What `StepEquations` is for one body, with a leading axis of candidates: coordinates y [B, R, 3]. Every method takes the
numbers `on` [b] of the candidates that it is asked about, so that those that have converged cost nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from physconvex.contact import Contact, Plane
from physconvex.materials import lame_parameters, project_to_positive, strain_stiffness
from physconvex.reduced.body import viscous_stress
from physconvex.reduced.candidate_volumetric import volumetric_blocks, volumetric_energy_and_gradient
from physconvex.reduced.scene import ReducedScene
from physconvex.volumetric_laws import is_volumetric

__all__ = ["CandidateEquations", "CandidateValues", "FrozenFriction", "Step"]

_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_BLOCK = 40_000_000  # numbers in the largest temporary of a Hessian


@dataclass(frozen=True)
class Step:
    """h̃ [s], `target` and `base` [m] of the potential (see `physconvex.integrators`), shape [B, R, 3]; end and
    duration [s] of the time step."""

    step: float
    target: Tensor
    base: Tensor
    time: float
    duration: float

    def velocity(self, y: Tensor, on: Tensor) -> Tensor:
        """New velocity of some candidates [m/s]."""
        return (y - self.base[on]) / self.step


@dataclass(frozen=True)
class CandidateValues:
    """E [Pa], ν, β [s], friction coefficient of every obstacle, kc [Pa/m] of each candidate, shape [B]."""

    youngs_modulus: np.ndarray
    poisson_ratio: np.ndarray
    damping_time: np.ndarray
    friction: np.ndarray
    contact_stiffness: np.ndarray


@dataclass
class FrozenFriction:
    """Drag of the surface samples on one obstacle, per candidate: weights [B, S] [N·s/m], normals [B, S, 3]."""

    weights: Tensor
    normals: Tensor
    velocity: Tensor

    def slip(self, v: Tensor, on: Tensor) -> Tensor:
        """Tangential velocity [m/s]."""
        relative, n = v - self.velocity, self.normals[on]
        return relative - (relative * n).sum(-1, keepdim=True) * n


class CandidateEquations:
    """Potentials of B candidates of one scene that differ in material, friction and contact stiffness.

    Args:
        scene: body, obstacles, gravity, push, air drag.
        values: what differs.
        device: of the arithmetic.
    """

    def __init__(self, scene: ReducedScene, values: CandidateValues, device: torch.device) -> None:
        self.scene, self.device = scene, device
        youngs_modulus, poisson_ratio, damping_time, friction, contact_stiffness = map(
            self.tensor,
            (
                values.youngs_modulus,
                values.poisson_ratio,
                values.damping_time,
                values.friction,
                values.contact_stiffness,
            ),
        )
        self.law, space = scene.body.law, scene.body.space
        self.contact: Contact = scene.contact()
        self.mu, self.lam = lame_parameters(youngs_modulus, poisson_ratio)
        self.damping_time, self.friction, self.stiffness = damping_time, friction, contact_stiffness
        self.size = space.dimension
        self.weights = self.tensor(space.samples.interior.weights)
        self.gradients = self.tensor(space.interior_gradients.transpose(0, 2, 1))  # [Q, j, R]
        self.flat = self.gradients.reshape(-1, self.size)  # [(Q, j), R]
        self.surface, self.areas = self.tensor(space.surface_values), self.tensor(self.contact.areas)
        self.mass, self.moments = self.tensor(scene.body.mass), self.tensor(scene.body.first_moments)
        self.eye = torch.eye(3, dtype=torch.float64, device=device)
        self.quick = is_volumetric(self.law)
        self.by_function = self.gradients.permute(2, 1, 0).reshape(self.size, -1).contiguous()  # [R, (j, Q)]
        self.laplacian = self.flat.mT @ (self.weights.repeat_interleave(3)[:, None] * self.flat)
        self.damped = bool((damping_time > 0).any())
        self.rough = bool((friction > 0).any())
        self.frozen: list[FrozenFriction] = []
        self.viscous = torch.zeros(0)
        self.forces = torch.zeros(0)
        self.now: Step | None = None

    def tensor(self, array: np.ndarray) -> Tensor:
        """An array on the device."""
        return torch.tensor(np.ascontiguousarray(array), dtype=torch.float64, device=self.device)

    # -- a step

    def set_step(self, step: Step, guess: Tensor, last: Tensor, last_time: float) -> None:
        """Fix what is constant during a step, as `StepEquations.set_step`."""
        self.now = step
        everyone = torch.arange(len(last), device=self.device)
        self.forces = self.moments[:, None] * self.tensor(self.scene.uniform_acceleration(step.time))
        if self.damped:
            self.viscous = self.deformation_gradient(guess)
        self.frozen = self._friction(last, step.velocity(guess, everyone), last_time, everyone)

    def freeze(self, y: Tensor, on: Tensor) -> None:
        """Take the friction of some candidates anew at coordinates y."""
        assert self.now is not None
        for old, new in zip(self.frozen, self._friction(y, self.now.velocity(y, on), self.now.time, on), strict=True):
            old.weights[on], old.normals[on] = new.weights, new.normals

    def _friction(self, y: Tensor, v: Tensor, time: float, on: Tensor) -> list[FrozenFriction]:
        if not self.rough:
            return []
        x, u, limit = self.surface @ y, self.surface @ v, self.contact.slip_velocity
        frozen = []
        for obstacle in self.contact.obstacles:
            depth, normals = self._depth(obstacle, x, time)
            part = FrozenFriction(torch.zeros_like(depth), normals, self.tensor(obstacle.velocity_at(time)))
            every = torch.arange(len(y), device=self.device)
            speed = torch.linalg.vector_norm(part.slip(u, every), dim=-1) / limit
            ratio = torch.where(speed < 1, 2 - speed, 1 / speed.clamp_min(1.0))
            pressure = self._hinge(depth, on)[1]
            part.weights = self.friction[on, None] * self.areas * pressure * ratio / limit
            frozen.append(part)
        return frozen

    # -- contact

    def _depth(self, obstacle: object, x: Tensor, time: float) -> tuple[Tensor, Tensor]:
        """Depth [m], positive inside, and normals of the surface samples."""
        assert isinstance(obstacle, Plane)
        normal = self.tensor(np.asarray(obstacle.normal))
        offset = float(obstacle.gap(np.zeros((1, 3)), time)[0])
        return -(x @ normal + offset), normal.expand_as(x).clone()

    def _hinge(self, depth: Tensor, on: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """ψ, ψ', ψ'' of `physconvex.contact`, zero outside."""
        e, p, k = self.contact.smoothing, depth.clamp_min(0.0), self.stiffness[on, None]
        soft = p < e
        energy = torch.where(soft, p**3 / (6 * e), p**2 / 2 - p * e / 2 + e * e / 6)
        slope = torch.where(soft, p**2 / (2 * e), p - e / 2)
        return k * energy, k * slope, k * torch.where(soft, p / e, 1.0)

    # -- value and gradient

    def deformation_gradient(self, y: Tensor) -> Tensor:
        """F at the interior samples, [b, Q, 3, 3]."""
        return (self.flat @ y).reshape(len(y), len(self.weights), 3, 3).mT

    def _forces_of(self, stress: Tensor) -> Tensor:
        weighted = (self.weights[:, None, None] * stress).mT
        return self.flat.mT @ weighted.reshape(len(stress), len(self.flat), 3)

    def evaluate(self, y: Tensor, on: Tensor) -> tuple[Tensor, Tensor]:
        """Incremental potentials [J], shape [b], and their derivatives [N], shape [b, R, 3]."""
        assert self.now is not None
        step, v = self.now.step, self.now.velocity(y, on)
        energy, gradient = self._material(y, on)
        if self.damped:
            rate, beta = self.deformation_gradient(v), self.damping_time[on, None]
            drag = viscous_stress(self.viscous[on], rate, beta * self.mu[on, None], beta * self.lam[on, None])
            energy = energy + 0.5 * step * (self.weights * (drag * rate).sum((-1, -2))).sum(-1)
            gradient = gradient + self._forces_of(drag)
        energy, gradient = energy - (self.forces * y).sum((-1, -2)), gradient - self.forces
        offset = y - self.now.target[on]
        pull, momentum = self.mass @ offset / step**2, self.scene.air_drag * (self.mass @ v)
        energy = energy + 0.5 * (offset * pull).sum((-1, -2)) + 0.5 * step * (v * momentum).sum((-1, -2))
        touch, push = self._surface(y, v, on)
        return energy + touch, gradient + pull + momentum + push

    def _material(self, y: Tensor, on: Tensor) -> tuple[Tensor, Tensor]:
        """Elastic energies and their derivatives."""
        mu, lam = self.mu[on, None], self.lam[on, None]
        if self.quick:
            return volumetric_energy_and_gradient(self.law, y, mu, lam, self.weights, self.by_function)
        f = self.deformation_gradient(y)
        return (self.weights * self.law.energy(f, mu, lam)).sum(-1), self._forces_of(self.law.stress(f, mu, lam))

    def _surface(self, y: Tensor, v: Tensor, on: Tensor) -> tuple[Tensor, Tensor]:
        """Contact and frozen friction."""
        assert self.now is not None
        x, u = self.surface @ y, self.surface @ v
        energy, force = torch.zeros_like(y[:, 0, 0]), torch.zeros_like(x)
        for obstacle in self.contact.obstacles:
            depth, normals = self._depth(obstacle, x, self.now.time)
            value, slope, _ = self._hinge(depth, on)
            energy = energy + value @ self.areas
            force = force - (self.areas * slope).unsqueeze(-1) * normals
        for part in self.frozen:
            slip = part.slip(u, on)
            drag = part.weights[on].unsqueeze(-1) * slip
            energy = energy + 0.5 * self.now.step * (drag * slip).sum((-1, -2))
            force = force + drag
        return energy, self.surface.mT @ force

    # -- Hessian

    def hessian(self, y: Tensor, on: Tensor, *, project: bool) -> Tensor:
        """Second derivatives [N/m], shape [b, 3 R, 3 R], components first; exact, or their positive part."""
        assert self.now is not None
        step, size = self.now.step, self.size
        lanes = max(1, _BLOCK // (len(self.weights) * max(81, 6 * size)))
        out = torch.cat(
            [self._elastic(a, b, project=project) for a, b in zip(y.split(lanes), on.split(lanes), strict=True)]
        )
        x = self.surface @ y
        blocks = torch.zeros(*x.shape, 3, dtype=torch.float64, device=self.device)
        for obstacle in self.contact.obstacles:
            depth, normals = self._depth(obstacle, x, self.now.time)
            stiffness = self.areas * self._hinge(depth, on)[2]
            blocks = blocks + stiffness[..., None, None] * normals.unsqueeze(-1) * normals.unsqueeze(-2)
        for part in self.frozen:
            n = part.normals[on]
            along = self.eye - n.unsqueeze(-1) * n.unsqueeze(-2)
            blocks = blocks + (part.weights[on] / step)[..., None, None] * along
        inertia = (1 / step**2 + self.scene.air_drag / step) * self.mass
        touched = torch.nonzero(blocks.any(-1).any(-1).any(0)).squeeze(-1)
        rows, blocks = self.surface[touched], blocks[:, touched]
        for i in range(3):
            out[:, i, :, i] += inertia
            for k in range(3):
                out[:, i, :, k] += rows.mT @ (blocks[:, :, i, k, None] * rows)
        return out.reshape(len(y), 3 * size, 3 * size)

    def _elastic(self, y: Tensor, on: Tensor, *, project: bool) -> Tensor:
        """Elasticity and viscosity, [b, 3, R, 3, R]."""
        assert self.now is not None
        mu, lam = self.mu[on, None], self.lam[on, None]
        f = self.deformation_gradient(y)
        if self.quick and not project and not self.damped:
            blocks = volumetric_blocks(self.law, f, mu, lam, self.weights, self.gradients)
            if blocks is not None:
                for i in range(3):
                    blocks[:, i, :, i] += self.mu[on, None, None] * self.laplacian
                return blocks
        tensor = self.law.hessian(f, mu, lam)
        tensor = project_to_positive(tensor) if project else tensor
        if self.damped:
            ratio = self.damping_time[on, None] / self.now.step
            tensor = tensor + strain_stiffness(self.viscous[on], ratio * mu, ratio * lam)
        a = (self.weights[:, None, None] * tensor).reshape(len(y), -1, 3, 3, 3, 3)
        out = torch.empty(len(y), 3, self.size, 3, self.size, dtype=torch.float64, device=self.device)
        for i, k in _PAIRS:
            half = a[:, :, i, :, k] @ self.gradients  # [b, Q, j, R]
            out[:, i, :, k] = self.flat.mT @ half.reshape(len(y), -1, self.size)
            if i != k:
                out[:, k, :, i] = out[:, i, :, k].mT
        return out
