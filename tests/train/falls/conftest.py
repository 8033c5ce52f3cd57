"""Two boxes that fall, simulated on the processor."""

import numpy as np
import pytest
import torch

from data_gen import Drop, FallingBody, ObjectMesh, falling_body
from physconvex.mesh import TetMesh, box_mesh
from train import Falls, simulate_falls

FRAMES = 16


def falling(edges: tuple[float, float, float], modulus: float, cells: int = 1) -> FallingBody:
    mesh = box_mesh(edges, (cells, cells, cells), order=2)
    mesh = TetMesh(mesh.vertices - np.array(edges) / 2, mesh.tets)
    vertices, faces = mesh.surface
    drop = Drop(
        object_id="box",
        family="box",
        body=ObjectMesh(vertices, faces, "box", "box"),
        rotation=np.eye(3),
        shift=np.array([0.0, 0.0, edges[2] / 2 + 0.3]),
        size=max(edges),
        youngs_modulus=modulus,
        poisson_ratio=0.3,
        density=1000.0,
        damping_time=2e-3,
        friction=0.5,
        initial_velocity=(0.3, 0.2, 0.0),
        initial_angular_velocity=(0.5, 0.0, 1.0),
    )
    return falling_body(drop, mesh, frames=FRAMES)


@pytest.fixture(scope="session")
def bodies() -> list[FallingBody]:
    return [falling((0.5, 0.4, 0.3), 5e4), falling((0.3, 0.3, 0.6), 2e5)]


@pytest.fixture(scope="session")
def falls(bodies: list[FallingBody]) -> Falls:
    return simulate_falls(bodies, frames=FRAMES)


@pytest.fixture(scope="session")
def finer_body() -> FallingBody:
    return falling((0.5, 0.4, 0.3), 5e4, cells=3)


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)
