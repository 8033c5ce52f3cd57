"""Boxes that fall: cheap enough to be rolled out on the processor."""

from collections.abc import Callable

import numpy as np
import pytest

from data_gen import Drop, FallingBody, ObjectMesh, falling_body
from physconvex.mesh import TetMesh, box_mesh

EDGE = 0.5


def make_box(cells: int = 2) -> TetMesh:
    """A cube about the origin [m]."""
    mesh = box_mesh((EDGE, EDGE, EDGE), (cells, cells, cells), order=2, mirrored=True)
    return TetMesh(mesh.vertices - EDGE / 2, mesh.tets)


def make_drop(height: float = 0.1, **changes: object) -> Drop:
    """A soft cube whose lowest point is so high over the floor [m]."""
    vertices, faces = make_box().surface
    values = {
        "object_id": "box",
        "family": "box",
        "body": ObjectMesh(vertices, faces, "box", "box"),
        "rotation": np.eye(3),
        "shift": np.array([0.0, 0.0, EDGE / 2 + height]),
        "size": EDGE,
        "youngs_modulus": 5e4,
        "poisson_ratio": 0.3,
        "density": 1000.0,
        "damping_time": 2e-3,
        "friction": 0.0,
        "initial_velocity": (0.0, 0.0, 0.0),
        "initial_angular_velocity": (0.0, 0.0, 0.0),
    }
    return Drop(**{**values, **changes})


@pytest.fixture
def body() -> FallingBody:
    return falling_body(make_drop(), make_box())


@pytest.fixture
def box() -> Callable[..., TetMesh]:
    return make_box


@pytest.fixture
def drop() -> Callable[..., Drop]:
    return make_drop
