"""Small scenes for the effects. Imports are inside the fixtures, see tests/reduced/conftest.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from physconvex.fem import Scene, TetMesh
    from physconvex.gap import Situation
    from physconvex.reduced import ReducedScene

E = 4e4


@pytest.fixture(scope="session")
def mesh() -> TetMesh:
    from physconvex.fem import box_mesh

    return box_mesh((0.2, 0.1, 0.1), (2, 1, 1), order=2)


@pytest.fixture(scope="session")
def falling(mesh: TetMesh) -> Scene:
    """Full-order block just above a floor, thrown forwards and down."""
    from physconvex.fem import ElasticBody, Plane, Scene

    body = ElasticBody(mesh, youngs_modulus=E, poisson_ratio=0.3)
    floor = Plane(point=(0, 0, float(mesh.vertices[:, 2].min()) - 0.01))
    return Scene(body, obstacles=(floor,), initial_velocity=(0.5, 0, -2.0))


@pytest.fixture(scope="session")
def falling_reduced(mesh: TetMesh, falling: Scene) -> ReducedScene:
    from physconvex.fem import ElasticBody
    from physconvex.reduced import BodySamples, ReducedBody, ReducedScene, ReducedSpace, eigenmode_weights

    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 4), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=E, poisson_ratio=0.3)
    return ReducedScene(body, obstacles=falling.obstacles, initial_velocity=falling.initial_velocity)


@pytest.fixture(scope="session")
def situation(mesh: TetMesh) -> Situation:
    from physconvex.gap import Situation

    return Situation(mesh.size, E, 1000.0, 60.0, 10, floor=True, touches=True, peak_stress=3e3)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)
