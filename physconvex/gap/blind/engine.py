"""A second engine for blind captures: explicit steps, linear tetrahedra, lumped masses, linear contact springs.

It shares nothing with the models of a diagnosis but the base law (stable neo-Hookean, Smith et al. 2018): no mesh, no
integrator, no contact law, and each effect in another form. Plastic and viscous flow store C_p⁻¹, so that the elastic
b_e = F C_p⁻¹ Fᵀ needs no singular values (Simo & Hughes 1998, §9.3, and Reese & Govindjee 1998, linearised).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from physconvex.errors import ConvergenceError
from physconvex.fem import TetMesh
from physconvex.gap.effects import Motion

__all__ = ["World", "run_explicit"]

_COURANT = 0.7
_MOST_STEPS = 1000  # per frame


@dataclass(frozen=True, eq=False)
class World:
    """What moves and what acts on it.

    Attributes:
        mesh: linear tetrahedra at t = 0 [m].
        youngs_modulus: E [Pa], one number or one per tetrahedron.
        poisson_ratio: ν.
        density: [kg/m³].
        gravity: [m/s²].
        floor: height of the floor [m]; None without one.
        held: nodes that do not move.
        velocity, spin: initial motion about the centre of mass [m/s], [rad/s].
        contact_modulus: contact pressure per depth over E/size [-].
        extra_mass: added to the nodes [kg], shape [V].
        friction: Coulomb coefficient.
        contact_damping: time of a dashpot beside the contact spring [s].
        damping_time: of Kelvin–Voigt viscosity [s].
        drag_rate: deceleration over velocity squared [1/m]; all of the body is slowed alike.
        wind: pressure per squared relative velocity times the air's velocity: ρ C_d/8 [kg/m³] and velocity [m/s].
        yield_stress: von Mises stress of the Kirchhoff stress at which flow sets in [Pa].
        branch: modulus ratio and relaxation time [s] of a Maxwell branch in the isochoric response.
        stiffening: β of a shear modulus μ (1 + β (I₁ − 3)).
        tied: stiffness of springs between nodes and where they started [N/m], shape [V].
        fibre: modulus over μ and direction of fibres, W = k/2 (I₄ − 1)².
    """

    mesh: TetMesh
    youngs_modulus: float | Float[np.ndarray, " E"]
    poisson_ratio: float
    density: float
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    floor: float | None = None
    held: np.ndarray | None = None
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    contact_modulus: float = 60.0
    extra_mass: np.ndarray | None = None
    friction: float = 0.0
    contact_damping: float = 0.0
    damping_time: float = 0.0
    drag_rate: float = 0.0
    wind: tuple[float, tuple[float, float, float]] | None = None
    yield_stress: float = np.inf
    branch: tuple[float, float] | None = None
    stiffening: float = 0.0
    fibre: tuple[float, np.ndarray] | None = None
    tied: np.ndarray | None = None


class _Body:
    """Forces of a `World`."""

    def __init__(self, world: World) -> None:
        self.world = world
        mesh = world.mesh
        self.tets = mesh.tets[:, :4]
        corners = mesh.vertices[self.tets]
        edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        inverse = np.linalg.inv(edges)
        self.gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)  # [E, 4, 3]
        self.volumes = np.abs(np.linalg.det(edges)) / 6
        count, used = len(mesh.vertices), len(self.tets)
        rows = self.tets.reshape(-1)
        self.scatter = sp.csr_matrix((np.ones(4 * used), (rows, np.arange(4 * used))), shape=(count, 4 * used))
        self.masses = world.density / 4 * np.bincount(rows, np.repeat(self.volumes, 4), minlength=count)
        if world.extra_mass is not None:
            self.masses = self.masses + world.extra_mass
        modulus = np.broadcast_to(np.asarray(world.youngs_modulus, dtype=float), (used,))
        self.mu = modulus / 2 / (1 + world.poisson_ratio)
        self.lam = modulus * world.poisson_ratio / (1 + world.poisson_ratio) / (1 - 2 * world.poisson_ratio)
        faces = mesh.boundary_faces[:, :3]
        triangle = mesh.vertices[faces]
        area = np.linalg.norm(np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]), axis=1) / 2
        self.areas = np.bincount(faces.reshape(-1), np.repeat(area / 3, 3), minlength=count)
        self.spring = world.contact_modulus * float(np.mean(modulus)) / mesh.size * self.areas
        self.flowed = np.broadcast_to(np.eye(3), (used, 3, 3)).copy()  # C_p⁻¹
        self.relaxed = self.flowed.copy()  # C_v⁻¹

    @cached_property
    def step(self) -> float:
        """Stable step [s], damping and contact included."""
        world = self.world
        height = 1 / np.linalg.norm(self.gradients, axis=2).max(1)
        extra = 1 + 4 * world.stiffening + (world.branch[0] if world.branch else 0.0)
        extra += 0.0 if world.fibre is None else 4 * world.fibre[0]
        wave = np.sqrt((self.lam + 2 * self.mu) * extra / world.density)
        fastest = float((2 * wave / height).max())
        slack = 0.5 * fastest * world.damping_time
        step = 2 / fastest * (np.sqrt(1 + slack**2) - slack)
        springy = self.areas > 0
        frequency = np.sqrt(float((self.spring[springy] / self.masses[springy]).max()))
        slack = 0.5 * frequency * world.contact_damping
        return _COURANT * min(step, 2 / frequency * (np.sqrt(1 + slack**2) - slack))

    def accelerations(self, x: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Of the nodes [m/s²]; plastic and viscous flow advance."""
        world = self.world
        f = x[self.tets].transpose(0, 2, 1) @ self.gradients
        stress = self._stress(f, dt)
        if world.damping_time > 0:
            rate = f.transpose(0, 2, 1) @ (v[self.tets].transpose(0, 2, 1) @ self.gradients)
            strain_rate = 0.5 * (rate + rate.transpose(0, 2, 1))
            trace = np.trace(strain_rate, axis1=1, axis2=2)
            second = 2 * self.mu[:, None, None] * strain_rate + (self.lam * trace)[:, None, None] * np.eye(3)
            stress = stress + world.damping_time * (f @ second)
        pull = self.gradients @ (stress * self.volumes[:, None, None]).transpose(0, 2, 1)
        force = -(self.scatter @ pull.reshape(-1, 3))
        force += self._contact(x, v)
        if world.wind is not None:
            relative = v - np.asarray(world.wind[1])
            speed = np.linalg.norm(relative, axis=1, keepdims=True)
            force -= world.wind[0] * self.areas[:, None] * speed * relative
        if world.tied is not None:
            force -= world.tied[:, None] * (x - world.mesh.vertices)
        out = force / self.masses[:, None] + np.asarray(world.gravity)
        if world.drag_rate:
            out -= world.drag_rate * np.linalg.norm(v, axis=1, keepdims=True) * v
        return np.asarray(out)

    def _stress(self, f: np.ndarray, dt: float) -> np.ndarray:
        """First Piola–Kirchhoff stress [Pa]."""
        world = self.world
        a, b, c = f[:, 0], f[:, 1], f[:, 2]
        cofactor = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
        volume = (a * cofactor[:, 0]).sum(1)
        if not (volume > 0).all():
            raise ConvergenceError("explicit engine: a tetrahedron turned inside out")
        mu = self.mu
        if world.stiffening:
            mu = mu * (1 + world.stiffening * np.maximum((f * f).sum((1, 2)) - 3, 0.0))
        pressure = (self.lam + self.mu) * (volume - 1) - self.mu
        elastic = f
        if np.isfinite(world.yield_stress):
            elastic = f @ self._yield(f, cofactor, volume)
        stress = mu[:, None, None] * elastic + pressure[:, None, None] * cofactor
        if world.branch is not None:
            ratio, time = world.branch
            inverse = cofactor / volume[:, None, None]  # F⁻ᵀ
            right = inverse.transpose(0, 2, 1) @ inverse  # C⁻¹
            self.relaxed += (1 - np.exp(-dt / time)) * (right - self.relaxed)
            stress = stress + (ratio * self.mu)[:, None, None] * (f @ self.relaxed - inverse)
        if world.fibre is not None:
            ratio, along = world.fibre
            carried = f @ along
            stretch = (carried**2).sum(1) - 1
            stress = stress + (2 * ratio * self.mu * stretch)[:, None, None] * carried[:, :, None] * along
        return stress

    def _yield(self, f: np.ndarray, cofactor: np.ndarray, volume: np.ndarray) -> np.ndarray:
        """C_p⁻¹ after the return to the yield surface."""
        left = f @ self.flowed @ f.transpose(0, 2, 1)
        mean = np.trace(left, axis1=1, axis2=2) / 3
        deviator = left - mean[:, None, None] * np.eye(3)
        size = np.sqrt(1.5) * self.mu * np.linalg.norm(deviator, axis=(1, 2))
        beyond = np.flatnonzero(size > self.world.yield_stress)
        if len(beyond):
            share = (self.world.yield_stress / size[beyond])[:, None, None]
            left = share * deviator[beyond] + mean[beyond][:, None, None] * np.eye(3)
            left *= np.cbrt(volume[beyond] ** 2 / np.linalg.det(left))[:, None, None]
            inverse = cofactor[beyond] / volume[beyond][:, None, None]  # F⁻ᵀ
            self.flowed[beyond] = inverse.transpose(0, 2, 1) @ left @ inverse
        return self.flowed

    def _contact(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        force = np.zeros_like(x)
        world = self.world
        if world.floor is None:
            return force
        depth = np.where(self.areas > 0, world.floor - x[:, 2], 0.0)
        nodes = np.flatnonzero(depth > 0)
        if len(nodes):
            normal = self.spring[nodes] * np.maximum(depth[nodes] - world.contact_damping * v[nodes, 2], 0.0)
            force[nodes, 2] = normal
            if world.friction:
                slip = v[nodes, :2]
                speed = np.linalg.norm(slip, axis=1)
                still = 1e-3 * np.sqrt(9.81 * world.mesh.size)
                force[nodes, :2] -= (world.friction * normal / np.maximum(speed, still))[:, None] * slip
        return force


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    x = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    y = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    return np.stack([x, y, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], axis=1)


def run_explicit(world: World, points: Float[np.ndarray, "P 3"], *, frames: int, fps: float) -> Motion:
    """Leapfrog; the motion of material points, given at t = 0.

    Raises:
        ConvergenceError: the run blew up.
    """
    from physconvex.fem import Embedding

    body = _Body(world)
    x = world.mesh.vertices.copy()
    centre = body.masses @ x / body.masses.sum()
    v = np.asarray(world.velocity) + np.cross(np.asarray(world.spin), x - centre)
    held = np.zeros(0, dtype=int) if world.held is None else world.held
    v[held] = 0.0
    count = int(np.ceil(1 / fps / body.step))
    if count > _MOST_STEPS:
        raise ConvergenceError(f"explicit engine: {count} steps per frame; expected at most {_MOST_STEPS}")
    dt = 1 / fps / count
    positions, velocities = [x.copy()], [v.copy()]
    v = v - 0.5 * dt * body.accelerations(x, v, 0.0)  # leapfrog: velocities half a step behind
    v[held] = 0.0
    for _ in range(1, frames):
        for _ in range(count):
            v = v + dt * body.accelerations(x, v, dt)
            v[held] = 0.0
            x = x + dt * v
        if not np.isfinite(x).all():
            raise ConvergenceError("explicit engine: the motion is not finite")
        positions.append(x.copy())
        velocities.append(v.copy())
    embedding = Embedding.of_points(world.mesh, points)
    times = np.arange(frames) / fps
    return Motion(points, times, embedding.apply(np.stack(positions)), embedding.apply(np.stack(velocities)))
