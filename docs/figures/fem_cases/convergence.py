"""Manufactured problems whose error must fall at a known rate, in space and in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from physconvex.dynamics import IntegratorName, Loads, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene, solve_static
from physconvex.mesh import QUADRATURE, TetMesh, barycentric_gradients, box_mesh, shape_gradients, shape_values

__all__ = ["Convergence", "elastic_displacement", "fitted_slope", "in_space", "in_time"]

NU, WAVE = 0.3, 2.0
SWING = 0.5  # s


@dataclass(frozen=True)
class Convergence:
    """Errors over mesh sizes [m] or time steps [s]; one list of errors per norm."""

    name: str
    sizes: list[float]
    errors: dict[str, list[float]]

    def slopes(self, last: int = 3) -> dict[str, float]:
        """Fitted order of each norm over the `last` finest sizes."""
        return {norm: fitted_slope(self.sizes[-last:], errors[-last:]) for norm, errors in self.errors.items()}


def fitted_slope(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of the least-squares line through log(error) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def elastic_displacement(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A solution of Navier's equations without body force, and its gradient: [.., 3], [.., 3, 3].

    Papkovich–Neuber with one harmonic function h: u = (3 − 4ν) h e_x − x ∇h; here h = sin(k y) sin(k z) exp(√2 k x)
    on the unit cube. Its divergence (2 − 4ν) ∂h/∂x does not vanish, so both Lamé constants count.
    """
    k, a = WAVE, np.sqrt(2) * WAVE
    sy, cy, sz, cz = (f(k * x[..., i]) for i in (1, 2) for f in (np.sin, np.cos))
    e = 1e-3 * np.exp(a * (x[..., 0] - 1))
    h = sy * sz * e
    first = np.stack([a * h, k * cy * sz * e, k * sy * cz * e], axis=-1)
    yz = k * k * cy * cz * e
    second = np.stack(
        [
            np.stack([a * a * h, a * first[..., 1], a * first[..., 2]], axis=-1),
            np.stack([a * first[..., 1], -k * k * h, yz], axis=-1),
            np.stack([a * first[..., 2], yz, -k * k * h], axis=-1),
        ],
        axis=-2,
    )
    along = np.eye(3)[0]
    u = (3 - 4 * NU) * h[..., None] * along - x[..., :1] * first
    gradient = (3 - 4 * NU) * along[:, None] * first[..., None, :] - x[..., :1, None] * second
    return u, gradient - first[..., :, None] * along


def _errors(mesh: TetMesh, u: np.ndarray) -> tuple[float, float]:
    """L2 norms of the error in u and in its gradient."""
    points, weights = QUADRATURE[4]
    corners = mesh.vertices[mesh.corner_tets]
    barycentric = barycentric_gradients(corners)
    exact, exact_gradient = elastic_displacement(np.einsum("qb,ebi->eqi", points, corners))
    values = np.einsum("qa,eai->eqi", shape_values(points, mesh.order), u[mesh.tets])
    gradients = np.einsum("qab,ebj,eai->eqij", shape_gradients(points, mesh.order), barycentric, u[mesh.tets])
    w = mesh.element_volumes[:, None] * weights
    first = (w * ((values - exact) ** 2).sum(-1)).sum()
    return float(np.sqrt(first)), float(np.sqrt((w * ((gradients - exact_gradient) ** 2).sum((-1, -2))).sum()))


def in_space(order: int, cells: Sequence[int]) -> Convergence:
    """Unit cube with the boundary at the exact displacement, cut into n³ cells of six tetrahedra."""
    sizes, displacement, gradient = [], [], []
    for n in cells:
        mesh = box_mesh((1.0, 1.0, 1.0), (n, n, n), order=order)
        boundary = mesh.node_areas > 0
        exact, _ = elastic_displacement(mesh.vertices)
        start = mesh.vertices + np.where(boundary[:, None], exact, 0.0)
        body = ElasticBody(mesh, law="linear", youngs_modulus=1e5, poisson_ratio=NU)
        scene = Scene(body, gravity=(0, 0, 0), initial_positions=start, node_pins=NodePins(np.flatnonzero(boundary)))
        errors = _errors(mesh, solve_static(scene) - mesh.vertices)
        sizes.append(1.0 / n)
        displacement.append(errors[0])
        gradient.append(errors[1])
    return Convergence(f"P{order}", sizes, {"displacement": displacement, "gradient": gradient})


def swinging_beam() -> Scene:
    """A soft cantilever (E 3e4 Pa, 0.3 m) shaken by a body force that sets in smoothly: 15 g sin²(2π t) sideways."""
    mesh = box_mesh((0.3, 0.1, 0.1), (3, 1, 1))
    body = ElasticBody(mesh, youngs_modulus=3e4, poisson_ratio=0.4)
    weight = 15.0 * body.node_masses[:, None] * np.array([0.0, 0.0, -1.0])
    return Scene(
        body,
        gravity=(0, 0, 0),
        loads=Loads(mesh.vertices, lambda t: weight * np.sin(2 * np.pi * t) ** 2),
        node_pins=NodePins(np.flatnonzero(mesh.vertices[:, 0] == 0)),
    )


@cache
def _swung(integrator: IntegratorName, steps: int) -> np.ndarray:
    """Positions after the swing."""
    options = Timing(frames=2, fps=1 / SWING, tolerance=1e-11)
    return simulate(swinging_beam(), replace(options, steps_per_frame=steps, integrator=integrator)).positions[-1]


def in_time(integrator: IntegratorName, steps: Sequence[int], *, reference: int = 3200) -> Convergence:
    """Largest error of a node at the end of a contact-free swing against BDF2 with `reference` steps."""
    exact = _swung("bdf2", reference)
    errors = [float(np.linalg.norm(_swung(integrator, n) - exact, axis=1).max()) for n in steps]
    return Convergence(integrator, [SWING / n for n in steps], {"position": errors})
