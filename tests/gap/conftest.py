"""Small scenes for the effects. Imports are inside the fixtures, see tests/reduced/conftest.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from physconvex.dynamics import Timing, simulate

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from physconvex.fem import Scene
    from physconvex.gap import Situation
    from physconvex.gap.base.baseline import Baseline
    from physconvex.io import Capture
    from physconvex.mesh import TetMesh
    from physconvex.reduced import ReducedScene

E = 4e4


@pytest.fixture(scope="session")
def mesh() -> TetMesh:
    from physconvex.mesh import box_mesh

    return box_mesh((0.2, 0.1, 0.1), (2, 1, 1), order=2)


@pytest.fixture(scope="session")
def falling(mesh: TetMesh) -> Scene:
    """Full-order block just above a floor, thrown forwards and down."""
    from physconvex.dynamics import Plane
    from physconvex.fem import ElasticBody, Scene

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


@pytest.fixture(scope="session")
def dropped_box(tmp_path_factory: pytest.TempPathFactory) -> Baseline:
    """Rough base fit of a box that strikes the floor in the middle of a frame."""
    from physconvex.dynamics import Plane, Timing, simulate
    from physconvex.fem import ElasticBody, Scene
    from physconvex.gap import GapOptions, rough_baseline
    from physconvex.io import Capture, Floor, Tracks, save_capture
    from physconvex.mesh import TetMesh, box_mesh

    frames, fps, size = 14, 40.0, 0.14
    up = np.array([0.0, 0.0, 0.5 * size + 0.05])
    mesh, corners = (box_mesh((0.1, 0.1, size), (1, 1, 1), order=order) for order in (2, 1))
    mesh, corners = (TetMesh(m.vertices + up, m.tets) for m in (mesh, corners))
    body = ElasticBody(mesh, youngs_modulus=2e5, poisson_ratio=0.35, density=1000.0)
    run = simulate(Scene(body, obstacles=(Plane(),)), Timing(frames=frames, fps=fps, steps_per_frame=10))
    capture = Capture(
        tmp_path_factory.mktemp("box") / "dropped", fps, frames, 10, density=1000.0,
        floor=Floor(np.zeros(3), np.array([0.0, 0.0, 1.0])),
        initial_velocity=np.zeros(3), initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    save_capture(capture, tets=corners, tracks=Tracks(mesh.vertices, run.positions, np.full((frames, 27), 1e-4)))
    return rough_baseline(capture, GapOptions(max_nodes=60, weights=4, iterations=2), lambda text: None)


@pytest.fixture(scope="session")
def released() -> Callable[[Path, float], Capture]:
    """Writes the capture of a beam of 0.2 MPa into a folder."""
    from physconvex.dynamics import HangingLoad
    from physconvex.fem import ElasticBody, NodePins, Scene
    from physconvex.io import Boundary, Capture, Tracks, save_capture
    from physconvex.mesh import TetMesh, box_mesh

    def released(folder: Path, ratio: float) -> Capture:
        """A beam that is held at its right end and let go, a load of so many of its own masses at its left end."""
        mesh = box_mesh((0.12, 0.03, 0.03), (8, 1, 1), order=2)
        corners = box_mesh((0.12, 0.03, 0.03), (8, 1, 1), order=1)
        body = ElasticBody(mesh, youngs_modulus=2e5, poisson_ratio=0.4, density=1000.0)
        x = mesh.vertices[:, 0]
        end, held = x < x.min() + 1e-9, np.flatnonzero(x > x.max() - 1e-9)
        load = HangingLoad(mesh.vertices, np.where(end, ratio * body.total_mass / end.sum(), 0.0)) if ratio else None
        run = simulate(
            Scene(body, node_pins=NodePins(held), hanging=load), Timing(frames=30, fps=80.0, steps_per_frame=8)
        )
        shown = np.flatnonzero(x < x.min() + 0.06)[::5]
        positions = run.positions[:, shown] + 5e-5 * np.random.default_rng(1).normal(size=(30, len(shown), 3))
        capture = Capture(folder / "capture", 80.0, 30, 20, gravity=np.array([0.0, 0.0, -9.81]), density=1000.0)
        box = np.array([[x.max() - 1e-4, -1.0, -1.0], [x.max() + 1e-4, 1.0, 1.0]])
        tracks = Tracks(mesh.vertices[shown], positions, np.full(positions.shape[:2], 5e-5))
        save_capture(
            capture, tets=TetMesh(corners.vertices, corners.tets), tracks=tracks, boundary=Boundary(clamped_box=box)
        )
        return capture

    return released
