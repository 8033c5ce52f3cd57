"""A second engine for blind captures: explicit steps, smoothed tetrahedra, lumped masses, linear contact springs.

It shares only the base law (stable neo-Hookean, Smith et al. 2018) with the models of a diagnosis. Mesh, elements,
integrator and contact law differ, and so does the form of each effect. Linear tetrahedra lock. Gradients are therefore
averaged around edges, and around nodes where λ multiplies them (selective ES/NS-FEM, Liu & Nguyen 2010, Smoothed Finite
Element Methods; Onishi & Amaya 2014). Plastic and viscous flow store C_p⁻¹, so the elastic b_e = F C_p⁻¹ Fᵀ needs no
singular values (Simo & Hughes 1998, §9.3, and Reese & Govindjee 1998, linearised).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from physconvex import ConvergenceError
from physconvex.gap import PointMotion
from physconvex.mesh import TetMesh

_COURANT = 0.7
_MOST_STEPS = 1000  # per frame
_POWER_STEPS = 60
_BEYOND_POWER = 1.1  # factor on the squared frequency, for the error of the iteration
_NOW = 1e-6  # tolerance in steps for taking a frame at a step


@dataclass(frozen=True, eq=False)
class ExplicitWorld:
    """The body and what acts on it.

    Attributes:
        mesh: linear tetrahedra at t = 0 [m].
        youngs_modulus: E [Pa], one number or one per tetrahedron.
        poisson_ratio: ν.
        density: [kg/m³].
        gravity: [m/s²].
        floor: height of the floor [m]; None without one.
        held: fixed nodes.
        velocity, spin: initial motion about the centre of mass [m/s], [rad/s].
        contact_modulus: contact pressure per depth over E/size [-].
        extra_mass: additional mass of the nodes [kg], shape [V].
        friction: Coulomb coefficient.
        contact_damping: time of a dashpot parallel to the contact spring [s].
        damping_time: time of Kelvin–Voigt viscosity [s].
        drag_rate: deceleration over velocity squared [1/m], uniform over the body.
        wind: pressure per squared relative velocity times the air's velocity: ρ C_d/8 [kg/m³] and velocity [m/s].
        yield_stress: von Mises norm of the Kirchhoff stress at the onset of flow [Pa].
        branch: modulus ratio and relaxation time [s] of a Maxwell branch in the isochoric response.
        stiffening: b of μ/2b (exp(b q) − 1 − b q), q = Ī₁ − 3, the exponential law (Demiray 1972) less its first term.
        tied: stiffness of springs between nodes and their initial places [N/m], shape [V].
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


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """Gradients averaged over domains that tetrahedra share: those around an edge, or around a node.

    Attributes:
        gradients: [3 D, V], rows by domain and direction.
        volumes: volumes of the domains [m³], shape [D].
        shares: share of each tetrahedron in the volume of each domain, [D, E].
    """

    gradients: sp.csr_matrix
    transposed: sp.csr_matrix
    volumes: np.ndarray
    shares: sp.csr_matrix

    @classmethod
    def over(cls, domains: np.ndarray, share: float, volumes: np.ndarray, slopes: sp.csr_matrix) -> _Smoothed:
        """Domains of each tetrahedron, [E, K]; each holds the same share of its volume."""
        columns = np.arange(len(domains)).repeat(domains.shape[1])
        parts = sp.csr_matrix((share * volumes[columns], (domains.reshape(-1), columns)))
        whole = np.asarray(parts.sum(1)).reshape(-1)
        shares = sp.diags(1 / whole) @ parts
        gradients = sp.csr_matrix(sp.kron(shares, sp.eye(3)) @ slopes)
        return cls(gradients, sp.csr_matrix(gradients.T), whole, sp.csr_matrix(shares))

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Values per domain from values per tetrahedron."""
        return np.asarray(self.shares @ values)

    def of(self, x: np.ndarray) -> np.ndarray:
        """∂x_i/∂X_j of each domain, [D, 3, 3]."""
        return np.asarray(self.gradients @ x).reshape(-1, 3, 3).transpose(0, 2, 1)

    def force(self, stress: np.ndarray) -> np.ndarray:
        """Forces on the nodes [N] from first Piola–Kirchhoff stresses [Pa]."""
        weighted = self.volumes[:, None, None] * stress.transpose(0, 2, 1)
        return -np.asarray(self.transposed @ weighted.reshape(-1, 3))


def _edges(tets: np.ndarray) -> np.ndarray:
    """Number of each of the six edges of the tetrahedra, [E, 6]."""
    pairs = np.sort(tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]], axis=2)
    _, numbers = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    return np.asarray(numbers).reshape(-1, 6)


class _Body:
    """Forces of an `ExplicitWorld`."""

    def __init__(self, world: ExplicitWorld) -> None:
        self.world = world
        mesh = world.mesh
        tets = mesh.tets[:, :4]
        corners = mesh.vertices[tets]
        edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        inverse = np.linalg.inv(edges)
        gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)  # [E, 4, 3]
        volumes = np.abs(np.linalg.det(edges)) / 6
        count = len(mesh.vertices)
        slopes = sp.csr_matrix(  # [3 E, V], rows by tetrahedron and direction
            (
                gradients.transpose(0, 2, 1).reshape(-1),
                (np.arange(3 * len(tets)).repeat(4), tets.repeat(3, axis=0).reshape(-1)),
            ),
            shape=(3 * len(tets), count),
        )
        self.shear = _Smoothed.over(_edges(tets), 1 / 6, volumes, slopes)
        self.bulk = _Smoothed.over(tets, 1 / 4, volumes, slopes)
        self.masses = world.density * self.bulk.volumes
        if world.extra_mass is not None:
            self.masses = self.masses + world.extra_mass
        modulus = np.broadcast_to(np.asarray(world.youngs_modulus, dtype=float), (len(tets),))
        self.mu = self.shear.mean(modulus / 2 / (1 + world.poisson_ratio))
        self.lam = self.bulk.mean(
            modulus * world.poisson_ratio / (1 + world.poisson_ratio) / (1 - 2 * world.poisson_ratio)
        )
        faces = mesh.boundary_faces[:, :3]
        triangle = mesh.vertices[faces]
        area = np.linalg.norm(np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]), axis=1) / 2
        self.areas = np.bincount(faces.reshape(-1), np.repeat(area / 3, 3), minlength=count)
        self.spring = world.contact_modulus * float(np.mean(modulus)) / mesh.size * self.areas
        self.flowed = np.broadcast_to(np.eye(3), (len(self.mu), 3, 3)).copy()  # C_p⁻¹
        self.relaxed = self.flowed.copy()  # C_v⁻¹

    @cached_property
    def step(self) -> float:
        """Stable step [s], damping and contact included."""
        world = self.world
        extra = 1 + 4 * world.stiffening + (world.branch[0] if world.branch else 0.0)
        extra += 0.0 if world.fibre is None else 4 * world.fibre[0]
        fastest = self._fastest() * np.sqrt(extra)
        slack = 0.5 * fastest * world.damping_time
        step = 2 / fastest * (np.sqrt(1 + slack**2) - slack)
        springy = self.areas > 0
        frequency = np.sqrt(float((self.spring[springy] / self.masses[springy]).max()))
        slack = 0.5 * frequency * world.contact_damping
        return _COURANT * min(step, 2 / frequency * (np.sqrt(1 + slack**2) - slack))

    def _fastest(self) -> float:
        """Highest angular frequency of the body at rest [rad/s], by power iteration on M⁻¹ K."""
        shape = np.random.default_rng(0).normal(size=(len(self.masses), 3))
        square = 0.0
        for _ in range(_POWER_STEPS):
            shape /= np.linalg.norm(shape)
            slope = self.shear.of(shape)
            strain = slope + slope.transpose(0, 2, 1)
            # σ of the law at F = I without its λ: 2 μ ε
            force = self.shear.force(self.mu[:, None, None] * strain)
            trace = np.trace(self.bulk.of(shape), axis1=1, axis2=2)
            force += self.bulk.force((self.lam * trace)[:, None, None] * np.eye(3))
            shape = -force / self.masses[:, None]
            square = float(np.linalg.norm(shape))
        return float(np.sqrt(_BEYOND_POWER * square))

    def accelerations(self, x: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Accelerations of the nodes [m/s²]; advances plastic and viscous flow."""
        world = self.world
        f, g = self.shear.of(x), self.bulk.of(x)
        stress = self._stress(f, dt)
        cofactor = _cofactor(g)
        swelling = (g[:, 0] * cofactor[:, 0]).sum(1)
        pressure = (self.lam * (swelling - 1))[:, None, None] * cofactor
        if world.damping_time > 0:
            rate = f.transpose(0, 2, 1) @ self.shear.of(v)
            stress = stress + world.damping_time * self.mu[:, None, None] * (f @ (rate + rate.transpose(0, 2, 1)))
            trace = (g * self.bulk.of(v)).sum((1, 2))  # trace of the rate of Green's strain
            pressure += (world.damping_time * self.lam * trace)[:, None, None] * g
        force = self.shear.force(stress) + self.bulk.force(pressure)
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
        """First Piola–Kirchhoff stress without the term λ/2 (J − 1)² [Pa]."""
        world = self.world
        cofactor = _cofactor(f)
        volume = (f[:, 0] * cofactor[:, 0]).sum(1)
        if not (volume > 0).all():
            raise ConvergenceError("explicit engine: a tetrahedron turned inside out")
        pressure = self.mu * (volume - 2)
        elastic = f
        if np.isfinite(world.yield_stress):
            elastic = f @ self._yield(f, cofactor, volume)
        stress = self.mu[:, None, None] * elastic + pressure[:, None, None] * cofactor
        if world.stiffening:
            shrink, square = volume ** (-2 / 3), (f * f).sum((1, 2))
            slope = 0.5 * self.mu * np.expm1(world.stiffening * (shrink * square - 3))
            along = f - (square / 3 / volume)[:, None, None] * cofactor
            stress = stress + (2 * shrink * slope)[:, None, None] * along  # ∂Ī₁/∂F = 2 J^(−2/3) (F − tr C/3 F⁻ᵀ)
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


def _cofactor(f: np.ndarray) -> np.ndarray:
    a, b, c = f[:, 0], f[:, 1], f[:, 2]
    return np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    x = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    y = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    return np.stack([x, y, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], axis=1)


def run_explicit(
    world: ExplicitWorld,
    points: Float[np.ndarray, "P 3"],
    *,
    frames: int,
    fps: float,
    late: float = 0.0,
    fast: float = 0.0,
) -> PointMotion:
    """Leapfrog integration; returns the motion of material points. Velocities lag by half a step.

    Args:
        world: the body and what acts on it.
        points: material points at t = 0 [m].
        frames: number of frames.
        fps: rate of the clock that stamps the frames [1/s].
        late: time of the first frame after t = 0 [s], not negative.
        fast: relative excess of the true time between frames over the clock's.

    Raises:
        ConvergenceError: the run diverges.
    """
    from physconvex.mesh import Embedding

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
    v = v - 0.5 * dt * body.accelerations(x, v, 0.0)  # leapfrog: velocities half a step behind
    v[held] = 0.0
    times = np.arange(frames) / fps
    positions, velocities, step = [], [], 0
    for taken in late + (1 + fast) * times:
        while taken > (step + _NOW) * dt:
            v = v + dt * body.accelerations(x, v, dt)
            v[held] = 0.0
            x, step = x + dt * v, step + 1
        if not np.isfinite(x).all():
            raise ConvergenceError("explicit engine: the motion is not finite")
        positions.append(x - (step * dt - taken) * v)
        velocities.append(v.copy())
    embedding = Embedding.of_points(world.mesh, points)
    return PointMotion(points, times, embedding.apply(np.stack(positions)), embedding.apply(np.stack(velocities)))
