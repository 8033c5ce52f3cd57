"""Beams and plates against beam theory and published values."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import spsolve

from physconvex.dynamics import Loads, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene, solve_static, surface_load, tangent_stiffness, vibration_modes
from physconvex.mesh import Embedding, TetMesh, box_mesh, to_quadratic

__all__ = [
    "SILICONE",
    "Cantilever",
    "KaolinBeam",
    "cantilever",
    "cook_membrane",
    "free_cube_frequencies",
    "kaolin_beam",
    "silicone_beam",
    "silicone_frequencies",
    "silicone_reference",
    "silicone_sag",
]

DATA = Path(__file__).parents[3] / "tests" / "data"
SILICONE = {"youngs_modulus": 263824.0, "density": 1070.0}  # Dubied et al. 2022
SILICONE_POINTS = np.array([[0.0, 0.015, 0.03], [0.0, 0.0, 0.024], [0.0, 0.03, 0.006]])  # m, beam frame


# --- cantilever under its own weight, small deflection


@dataclass(frozen=True)
class Cantilever:
    """Tip deflections [m] of a cantilever and what Euler–Bernoulli and Timoshenko say."""

    slenderness: float
    tip: float
    euler_bernoulli: float
    timoshenko: float


def cantilever(slenderness: float, *, order: int = 2, cells: tuple[int, int, int] | None = None) -> Cantilever:
    """Square beam of 1 m, ν = 0 so that the clamp restrains nothing that beam theory leaves free."""
    height, e, rho, g = 1.0 / slenderness, 1e9, 1000.0, 9.81
    mesh = box_mesh((1.0, height, height), cells or (max(4, round(2 * slenderness)), 2, 2), order=order)
    body = ElasticBody(mesh, law="linear", youngs_modulus=e, poisson_ratio=0.0, density=rho)
    x = solve_static(Scene(body, gravity=(0, 0, -g), node_pins=NodePins(np.flatnonzero(mesh.vertices[:, 0] == 0))))
    tip = (mesh.vertices - x)[np.isclose(mesh.vertices[:, 0], 1.0), 2].mean()
    weight, inertia, shear = rho * g * height**2, height**4 / 12, e / 2 * height**2
    bending = weight / (8 * e * inertia)
    # shear coefficient of a rectangle at ν = 0 (Cowper 1966): κ = 10 (1 + ν)/(12 + 11 ν) = 5/6
    return Cantilever(slenderness, float(tip), bending, bending + weight / (2 * 5 / 6 * shear))


# --- Warp FEM beam of Kaolin's tests


@dataclass(frozen=True)
class KaolinBeam:
    """Distances [m] to the reference after the first step and at rest; where the middle of the free end goes [m]."""

    law: str
    nodes: int
    first_step_mean: float
    first_step_motion: float
    mean: float
    largest: float
    motion: float
    tip: list[float]


def kaolin_beam(law: str, cells: tuple[int, int, int] = (12, 3, 3)) -> KaolinBeam:
    """1 × 0.25 × 0.25 m, E 1e5, ν 0.45, ρ 500, clamped at x ≥ 0.98, gravity 9.8 along −y.

    The reference holds implicit Euler with 0.05 s after 1 and 100 steps. Its last state is at rest, though implicit
    Euler alone leaves the tip swinging by some 2 cm then: it is compared with the static solution.
    """
    reference = np.load(DATA / "warpfem_kaolin" / "beam.npz")
    start, first, end = (reference[name].astype(float) for name in ("v0", "v1", "v_end"))
    mesh = box_mesh((1.0, 0.25, 0.25), cells)
    mesh = TetMesh(mesh.vertices + np.array([0.0, 0.75, 0.75]), mesh.tets)
    body = ElasticBody(mesh, law=law, youngs_modulus=1e5, poisson_ratio=0.45, density=500.0)
    scene = Scene(body, gravity=(0, -9.8, 0), node_pins=NodePins(np.flatnonzero(mesh.vertices[:, 0] > 0.98)))
    run = simulate(scene, Timing(frames=2, fps=20, steps_per_frame=1, integrator="implicit_euler"))
    rest = solve_static(scene, load_steps=2)
    carried = Embedding.of_points(mesh, start).apply(np.stack([run.positions[1], rest]))
    distances = np.linalg.norm(carried - [first, end], axis=2)
    tip = np.argmin(np.linalg.norm(mesh.vertices - [0.0, 0.875, 0.875], axis=1))
    return KaolinBeam(
        law=law,
        nodes=len(mesh.vertices),
        first_step_mean=float(distances[0].mean()),
        first_step_motion=float(np.linalg.norm(first - start, axis=1).max()),
        mean=float(distances[1].mean()),
        largest=float(distances[1].max()),
        motion=float(np.linalg.norm(end - start, axis=1).max()),
        tip=(rest[tip] - mesh.vertices[tip]).tolist(),
    )


# --- silicone beam of Dubied et al. 2022, 100 × 30 × 30 mm, clamped at x = −0.1


def silicone_beam(cells: tuple[int, int, int] = (10, 3, 3), *, poisson_ratio: float = 0.499, **options) -> ElasticBody:
    """The beam in its own frame: axial (free end at 0), lateral, up [m]."""
    mesh = box_mesh((0.1, 0.03, 0.03), cells)
    mesh = TetMesh(mesh.vertices - np.array([0.1, 0.0, 0.0]), mesh.tets)
    return ElasticBody(mesh, poisson_ratio=poisson_ratio, **(SILICONE | options))


def clamp(body: ElasticBody) -> NodePins:
    """The nodes of the clamped end."""
    return NodePins(np.flatnonzero(np.isclose(body.mesh.vertices[:, 0], -0.1)))


def edge_load(mesh: TetMesh, force: Sequence[float]) -> np.ndarray:
    """A line force [N] along the top edge of the free end, consistent with the shape functions."""
    x = mesh.vertices
    nodes = np.flatnonzero(np.isclose(x[:, 0], 0) & np.isclose(x[:, 2], 0.03))
    nodes = nodes[np.argsort(x[nodes, 1])]
    count = (len(nodes) - 1) // mesh.order
    simpson = np.array([0.5, 0.5]) if mesh.order == 1 else np.array([1, 4, 1]) / 6
    forces = np.zeros_like(x)
    for n in range(count):
        forces[nodes[mesh.order * n : mesh.order * (n + 1) + 1]] += simpson[:, None] / count * np.asarray(force)
    return forces


def face_load(mesh: TetMesh, force: Sequence[float]) -> np.ndarray:
    """The same force spread over the free end."""
    return surface_load(mesh, lambda c: np.isclose(c[:, 0], 0), np.asarray(force) / 9e-4)


def silicone_sag(body: ElasticBody, *, load: float = 0.0, where: str = "edge") -> np.ndarray:
    """Static displacement [3, 3] (points × axes, m) at the three points of the reference."""
    spread = {"edge": edge_load, "face": face_load}[where]
    forces = Loads(body.mesh.vertices, spread(body.mesh, (0, 0, -load))) if load else None
    scene = Scene(body, gravity=(0, 0, -9.80709), node_pins=clamp(body), loads=forces)
    displacement = solve_static(scene, load_steps=2 if load else 1) - body.mesh.vertices
    return Embedding.of_points(body.mesh, SILICONE_POINTS).apply(displacement)


def silicone_reference(name: str) -> np.ndarray:
    """Displacements [3, 3] in metres: "comsol gravity", "comsol load101", or "ngsolve <key of the file>"."""
    content = json.loads((DATA / "srl_silicone_beam" / "srl_beam_fem.json").read_text())
    source, key = name.split(" ", 1)
    table = content["comsol_from_authors"][key] if source == "comsol" else content["ngsolve_run_here"][key]["disp_mm"]
    return np.array(list(table.values())) * 1e-3


def silicone_frequencies(poisson_ratio: float, cells: tuple[int, int, int] = (10, 3, 3), count: int = 6) -> np.ndarray:
    """First frequencies [Hz] of the clamped beam about its rest state."""
    body = silicone_beam(cells, poisson_ratio=poisson_ratio)
    clamped = np.zeros(len(body.mesh.vertices), dtype=bool)
    clamped[clamp(body).nodes] = True
    return vibration_modes(body, count, clamped=clamped)[0]


def free_cube_frequencies(cells: int = 4) -> np.ndarray:
    """First frequencies [Hz] above the rigid ones of a free unit cube: E 1e5, ν 0.45, ρ 500."""
    mesh = box_mesh((1.0, 1.0, 1.0), (cells, cells, cells))
    body = ElasticBody(mesh, youngs_modulus=1e5, poisson_ratio=0.45, density=500.0)
    return vibration_modes(body, 15)[0][6:]


# --- Cook's membrane


def cook_membrane(
    cells: int, *, plane: str, at: float = 60.0, youngs_modulus: float = 70e6, traction: float = 6.25e6
) -> float:
    """Rise [m] of the point (48, `at`) mm of Cook's membrane (ν = 1/3), plane "strain" or "stress".

    One layer of quadratic tetrahedra, 1 mm thick. Plane strain holds all nodes at z = 0 of displacement, which pins do
    not offer (they hold whole nodes): the linear system is assembled and solved here.
    """
    square = box_mesh((1.0, 1.0, 1.0 / cells), (cells, cells, 1), order=1)
    s, t = square.vertices[:, 0], square.vertices[:, 1]
    y = t * (44 + 16 * s) + (1 - t) * 44 * s
    mesh = to_quadratic(TetMesh(np.column_stack([48 * s, y, square.vertices[:, 2] * cells]) * 1e-3, square.tets))
    body = ElasticBody(mesh, law="linear", youngs_modulus=youngs_modulus, poisson_ratio=1 / 3)
    load = surface_load(mesh, lambda c: np.isclose(c[:, 0], 0.048), (0, traction, 0))
    stiffness = tangent_stiffness(body)
    free = np.repeat(mesh.vertices[:, :1] > 0, 3, axis=1)
    # plane strain: no displacement along z anywhere; plane stress: none on the plane of symmetry z = 0
    free[:, 2] &= (plane == "stress") & (mesh.vertices[:, 2] > 0)
    keep = np.flatnonzero(free.ravel())
    u = np.zeros(free.size)
    u[keep] = spsolve(stiffness[keep][:, keep].tocsc(), load.ravel()[keep])
    point = np.linalg.norm(mesh.vertices[:, :2] - [0.048, 1e-3 * at], axis=1) < 1e-9
    return float(u.reshape(-1, 3)[point, 1].mean())
