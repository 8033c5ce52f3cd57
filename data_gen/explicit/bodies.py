"""Falling bodies as the input of explicit roll-outs: small to store, in the kernel's layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int, Int16, Int32, UInt16
from scipy.spatial.transform import Rotation

from data_gen.explicit.chebyshev import chebyshev_coefficients, reach, stages_for
from data_gen.landing import mass_properties, turning
from data_gen.scene import Drop
from physconvex.dynamics import contact_defaults
from physconvex.fem import ElasticBody
from physconvex.io import Workers
from physconvex.materials import lame_parameters
from physconvex.mesh import TetMesh, linear_part, to_quadratic

FPS = 24.0  # [1/s]
GRAVITY = (0.0, 0.0, -9.81)  # [m/s²]
LARGEST = 2048  # nodes, as in gpu/kernel.cu
_LEAST_STEPS = 48  # per frame
_LEAST_STAGES = 20  # friction needs these, since it is as stiff on soft bodies
_SAFETY = 2.0  # of the stiffness, which grows where elements are squeezed
_LUMPED = np.array([1 / 36] * 4 + [4 / 27] * 6)  # Hinton, Rock, Zienkiewicz 1976: the consistent diagonal, scaled
_CONTACT = 8.0  # most (step × frequency of a node on the floor)², beyond which friction may be unstable
_MARGIN = 2e-3  # [s] before the landing
_POWER = 30  # iterations

Array = TypeVar("Array", np.ndarray, torch.Tensor)


@dataclass(frozen=True, eq=False)
class FallingBody:
    """A drop, its mesh and its flight until just before it lands, in SI units.

    Attributes:
        corners: corner nodes of the quadratic mesh in any frame, shape [V, 3]; bodies of one shape share them.
        tets: between them, shape [E, 4].
        place: maps corners to the start of the drop, scale included: x → place[:, :3] x + place[:, 3].
        size: largest edge of the body's box there [m].
        youngs_modulus, poisson_ratio, density, damping_time, friction: of the drop.
        turns: rotations since the start at the frames of the flight, quaternions (x, y, z, w), shape [T, 4].
        centres: of mass at these, shape [T, 3].
        velocity, spin: at the last of them [m/s], [rad/s].
        stiffest: largest ω² of the elements [1/s²].
    """

    corners: Float32[np.ndarray, "V 3"]
    tets: UInt16[np.ndarray, "E 4"]
    place: Float64[np.ndarray, "3 4"]
    size: float
    youngs_modulus: float
    poisson_ratio: float
    density: float
    damping_time: float
    friction: float
    turns: Float32[np.ndarray, "T 4"]
    centres: Float32[np.ndarray, "T 3"]
    velocity: Float64[np.ndarray, " 3"]
    spin: Float64[np.ndarray, " 3"]
    stiffest: float

    def mesh(self) -> TetMesh:
        """Its quadratic mesh where the drop starts."""
        corners = self.corners @ self.place[:, :3].T + self.place[:, 3]
        return to_quadratic(TetMesh(corners, self.tets.astype(np.int64)))


def falling_body(drop: Drop, mesh: TetMesh, *, scale: float = 1.0, frames: int = 24) -> FallingBody:
    """A drop with a mesh of its body, lifted off the floor if its nodes reach below.

    Args:
        drop: the drop.
        mesh: in the frame of `drop.body`, except for the scale.
        scale: of the drop's body over the mesh.
        frames: of the fall.
    """
    linear = linear_part(mesh)
    corners = linear.vertices.astype(np.float32)
    x = drop.placed(scale * corners.astype(np.float64))
    shift = drop.shift + np.array([0.0, 0.0, max(0.0, 1e-3 * drop.size - x[:, 2].min())])
    placed = TetMesh(x + shift - drop.shift, linear.tets)
    turns, centres, velocity, spin = _flight(drop, placed, frames)
    return FallingBody(
        corners=corners,
        tets=linear.tets.astype(np.uint16),
        place=np.column_stack([scale * drop.rotation, shift]),
        size=drop.size,
        youngs_modulus=drop.youngs_modulus,
        poisson_ratio=drop.poisson_ratio,
        density=drop.density,
        damping_time=drop.damping_time,
        friction=drop.friction,
        turns=turns.astype(np.float32),
        centres=centres.astype(np.float32),
        velocity=velocity,
        spin=spin,
        stiffest=_stiffest(drop, to_quadratic(placed)),
    )


def _lumped_masses(mesh: TetMesh, density: float) -> Float64[np.ndarray, " V"]:
    shares = density * mesh.element_volumes[:, None] * _LUMPED
    return np.bincount(mesh.tets.ravel(), shares.ravel(), minlength=len(mesh.vertices))


def _stiffest(drop: Drop, mesh: TetMesh) -> float:
    """Largest eigenvalue of any element's stiffness with the lumped masses, a bound for the mesh [1/s²]."""
    elastic = ElasticBody(
        mesh, youngs_modulus=drop.youngs_modulus, poisson_ratio=drop.poisson_ratio, density=drop.density
    )
    stiffness = elastic.element_hessians(mesh.vertices)
    mass = np.repeat(drop.density * mesh.element_volumes[:, None] * _LUMPED, 3, axis=1)
    vector = np.random.default_rng(0).normal(size=mass.shape)
    value = np.ones(len(mass))
    for _ in range(_POWER):
        vector = np.einsum("eab,eb->ea", stiffness, vector) / mass
        value = np.sqrt((vector**2).sum(axis=1))
        vector /= value[:, None]
    return float(value.max())


def _flight(
    drop: Drop, mesh: TetMesh, frames: int
) -> tuple[
    Float64[np.ndarray, "T 4"], Float64[np.ndarray, "T 3"], Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]
]:
    """Rotations and centres at the frames before the rigid body touches the floor, velocity and spin at the last."""
    centre, inertia = mass_properties(mesh)
    arms = mesh.vertices - centre
    speed, between = np.asarray(drop.initial_velocity), int(np.ceil(1000 / FPS))
    step, largest = 1 / (FPS * between), np.linalg.norm(arms, axis=1).max()
    turns: list[np.ndarray] = []
    centres: list[np.ndarray] = []
    velocity, spin_then = speed, np.asarray(drop.initial_angular_velocity)
    turned = turning(inertia, drop.initial_angular_velocity, step)
    for number, (turn, spin) in zip(range((frames - 1) * between + 1), turned, strict=False):
        time = number * step
        gained = np.array([0.0, 0.0, time * GRAVITY[2]])
        now, fall = centre + time * (speed + 0.5 * gained), speed[2] + gained[2]
        lowest = now[2] - largest if now[2] > 1.1 * largest else now[2] + (arms @ turn.as_matrix()[2]).min()
        if turns and lowest + _MARGIN * (fall - np.linalg.norm(spin) * largest) <= 0:
            break
        if number % between == 0:
            turns.append(turn.as_quat())
            centres.append(now)
            velocity, spin_then = speed + gained, spin
    return np.stack(turns), np.stack(centres), velocity, spin_then


@dataclass(frozen=True, eq=False)
class Layout:
    """Bodies one behind the other, in the kernel's format (gpu/kernel.cu); `out` contains the flight already.

    Body n has its nodes at `table[n, 0]`, `table[n, 1]` of them.
    """

    table: Int32[np.ndarray, "B 9"]
    materials: Float32[np.ndarray, "B 10"]
    coefficients: Float32[np.ndarray, "C 4"]
    geometry: Float32[np.ndarray, "E 10"]
    corners: Int16[np.ndarray, "E 10"]
    incident: Int32[np.ndarray, " S"]
    begin: Int32[np.ndarray, " N1"]
    nodes: Float32[np.ndarray, "N 2"]
    start: Float32[np.ndarray, "N 6"]
    out: Float32[np.ndarray, " T"]
    frames: int
    boundary: tuple[Int[np.ndarray, "F 3"], ...]
    """Triangles of each body's surface, between its nodes."""

    def positions(self, out: Array, body: int) -> Array:
        """Positions of one body, from a filled `out`: [T, V, 3] m, an array or a tensor like `out`."""
        node, count = (int(v) for v in self.table[body, :2])
        return out[3 * node * self.frames :][: 3 * count * self.frames].reshape(self.frames, count, 3)


@dataclass(frozen=True, eq=False)
class _Laid:
    """One body's part of a layout, in compact form, since it comes from another process."""

    material: Float32[np.ndarray, " 10"]
    stages: int
    steps: int
    geometry: Float32[np.ndarray, "E 10"]
    corners: Int16[np.ndarray, "E 10"]
    incident: Int32[np.ndarray, " S"]
    begin: Int32[np.ndarray, " V1"]
    nodes: Float32[np.ndarray, "V 2"]
    start: Float32[np.ndarray, "V 6"]
    first_frame: int
    flight: Float32[np.ndarray, "T V 3"]
    boundary: Int32[np.ndarray, "F 3"]


def lay_out(bodies: Sequence[FallingBody], *, frames: int = 24, caution: float = 1.0, workers: int = 0) -> Layout:
    """The kernel's input.

    Args:
        bodies: those with the longest computation come first.
        frames: of the falls.
        caution: steps are shorter by this factor than usual.
        workers: processes; up to 1, this process does everything.
    """
    lay = partial(_laid, frames=frames, caution=caution)
    with Workers(max(workers, 1)) as pool:
        laid = pool.map(lay, bodies)
    stages = sorted({one.stages for one in laid})
    offset = dict(zip(stages, np.cumsum([0] + [s + 1 for s in stages]), strict=False))
    table = []
    node = element = slot = total = 0
    for one in laid:
        count, elements = len(one.nodes), len(one.corners)
        table.append((node, count, element, elements, one.first_frame, one.stages, offset[one.stages], slot, one.steps))
        node, element, total = node + count, element + elements, total + 3 * count * frames
        slot += len(one.incident)
    joined = {
        name: np.concatenate([getattr(one, name) for one in laid])
        for name in ("geometry", "corners", "incident", "begin", "nodes", "start")
    }
    layout = Layout(
        table=np.array(table, np.int32),
        materials=np.stack([one.material for one in laid]),
        coefficients=np.concatenate([chebyshev_coefficients(s) for s in stages]).astype(np.float32),
        **joined,
        out=np.zeros(total, np.float32),
        frames=frames,
        boundary=tuple(one.boundary for one in laid),
    )
    for number, one in enumerate(laid):
        layout.positions(layout.out, number)[: len(one.flight)] = one.flight
    return layout


def _laid(body: FallingBody, frames: int, caution: float) -> _Laid:
    mesh = body.mesh()
    size, turns, centres = mesh.size, body.turns[:frames], body.centres[:frames]
    stiffness, smoothing, slip = contact_defaults(body.youngs_modulus, size)
    masses, areas = _lumped_masses(mesh, body.density), mesh.node_areas
    fastest = stiffness * float((areas / masses).max())
    steps = int(np.ceil(caution * max(_LEAST_STEPS, np.sqrt(fastest / _CONTACT) / FPS)))
    step = 1 / (FPS * steps)
    stages = max(_LEAST_STAGES, stages_for(_SAFETY * step * body.damping_time * body.stiffest))
    mu, lam = lame_parameters(
        *(torch.tensor(v, dtype=torch.float64) for v in (body.youngs_modulus, body.poisson_ratio))
    )
    material = (
        *(float(mu), float(lam), body.damping_time, stiffness, smoothing, body.friction, slip),
        *(step, GRAVITY[2], 0.25 * reach(stages) / step),
    )
    x = mesh.vertices[mesh.corner_tets]
    inner = np.linalg.inv(x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    arms = mesh.vertices - mass_properties(mesh)[0]
    flight = np.stack([Rotation.from_quat(q).apply(arms) + c for q, c in zip(turns, centres, strict=True)])
    velocities = body.velocity + np.cross(body.spin, flight[-1] - centres[-1])
    owner = mesh.tets.ravel()
    return _Laid(
        material=np.array(material, np.float32),
        stages=stages,
        steps=steps,
        geometry=np.column_stack([inner.reshape(len(x), 9), mesh.element_volumes]).astype(np.float32),
        corners=mesh.tets.astype(np.int16),
        incident=np.argsort(owner, kind="stable").astype(np.int32),
        begin=np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(arms)))]).astype(np.int32),
        nodes=np.column_stack([masses, areas]).astype(np.float32),
        start=np.hstack([flight[-1], velocities]).astype(np.float32),
        first_frame=len(flight) - 1,
        flight=flight.astype(np.float32),
        boundary=_triangles(mesh).astype(np.int32),
    )


def _triangles(mesh: TetMesh) -> Int[np.ndarray, "F 3"]:
    """The faces of the surface cut in four at the middles of their edges."""
    a, b, c, ab, bc, ca = mesh.boundary_faces.T
    return np.concatenate([np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
