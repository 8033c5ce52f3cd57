"""A drop simulated by the full-order FEM: surface and interior trajectories, skinning eigenmodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from data_gen.config import GeneratorConfig, SolverConfig
from data_gen.landing import refine_at_landing
from data_gen.scene import Drop
from physconvex import ConvergenceError, InputError
from physconvex.dynamics import Plane, SolveStatistics, World, simulate
from physconvex.fem import ElasticBody, Scene, SurfacePoints, Trajectory, skinning_eigenmodes
from physconvex.mesh import Embedding, TetMesh, sample_interior, tetrahedralize, tetrahedralize_implicit


@dataclass(frozen=True, eq=False)
class Samples:
    """Interior points of a simulation.

    Attributes:
        points: rest positions at the start of the drop [m], shape [S, 3].
        volume_weights: volume of each point [m³], shape [S].
        displacements: [m], shape [T, S, 3].
        modes: skinning eigenmodes without the constant one, shape [S, K].
        eigenvalues: of the modes [1/s²], shape [K].
    """

    points: Float[np.ndarray, "S 3"]
    volume_weights: Float[np.ndarray, " S"]
    displacements: Float[np.ndarray, "T S 3"]
    modes: Float[np.ndarray, "S K"]
    eigenvalues: Float[np.ndarray, " K"]


@dataclass(frozen=True, eq=False)
class SimulatedDrop:
    """Result of one simulation: the tetrahedra, surface positions [T, P, 3] m, interior samples, cost."""

    mesh: TetMesh
    trajectory: Trajectory
    surface: Float[np.ndarray, "T P 3"]
    samples: Samples

    @property
    def statistics(self) -> SolveStatistics:
        """Cost of the solve."""
        return self.trajectory.statistics


def make_mesh(drop: Drop, solver: SolverConfig, gravity: Sequence[float]) -> TetMesh:
    """Quadratic tetrahedra of the drop's body at its start: at most `target_nodes` nodes, more where it lands.

    Raises:
        ConvergenceError: no valid mesh is found.
    """
    body = drop.body
    surface = (body.vertices, body.faces)
    try:
        if body.signed_distance is not None:
            mesh = tetrahedralize_implicit(
                body.signed_distance, body.bounds, surface=surface, max_nodes=solver.target_nodes, order=2
            )
        else:
            mesh = tetrahedralize(surface, max_nodes=solver.target_nodes, order=2, method="auto")
    except InputError as error:  # one bad body is a failed simulation, not the end of the run
        raise ConvergenceError(f"{body.name}: {error}") from error
    x = drop.placed(mesh.vertices)
    x[:, 2] += max(0.0, 1e-3 * drop.size - x[:, 2].min())
    world = World(
        gravity=gravity,
        initial_velocity=drop.initial_velocity,
        initial_angular_velocity=drop.initial_angular_velocity,
    )
    return refine_at_landing(TetMesh(x, mesh.tets), solver.landing_nodes, world)


def simulate_drop(
    drop: Drop, config: GeneratorConfig, rng: np.random.Generator, *, mesh: TetMesh | None = None
) -> SimulatedDrop:
    """Mesh (unless `mesh` is a result of `make_mesh`), simulate and sample a drop.

    Raises:
        ConvergenceError: meshing or the solve fails.
    """
    solver, video = config.solver, config.video
    mesh = make_mesh(drop, solver, config.motion.gravity) if mesh is None else mesh
    body = ElasticBody(
        mesh,
        law=config.material.law,
        youngs_modulus=drop.youngs_modulus,
        poisson_ratio=drop.poisson_ratio,
        density=drop.density,
    )
    shown = drop.placed(drop.body.vertices)
    scene = Scene(
        body=body,
        obstacles=(Plane(friction=drop.friction),),
        contact_points=SurfacePoints.of_triangles(shown, drop.body.faces) if solver.touching == "surface" else None,
        gravity=config.motion.gravity,
        damping_time=drop.damping_time,
        initial_velocity=drop.initial_velocity,
        initial_angular_velocity=drop.initial_angular_velocity,
    )
    trajectory = simulate(scene, solver.timing(video.frames, video.fps))
    surface = Embedding.of_points(mesh, shown).apply(trajectory.positions)
    return SimulatedDrop(mesh, trajectory, surface, _samples(body, trajectory, config, rng))


def _samples(body: ElasticBody, trajectory: Trajectory, config: GeneratorConfig, rng: np.random.Generator) -> Samples:
    points, volume_weights = sample_interior(body.mesh, config.samples.points, rng)
    embedding = Embedding.of_points(body.mesh, points)
    weights, eigenvalues = skinning_eigenmodes(body, config.samples.modes)
    moved = embedding.apply(trajectory.positions)
    return Samples(points, volume_weights, moved - points, embedding.apply(weights), eigenvalues)
