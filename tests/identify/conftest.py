"""A small dropped box: its twin, and markers that were made with it.

The imports are inside the fixtures: `--typecheck` wants to be there before the packages are imported.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from tests.painted_box import box_surface, painted_wedges

if TYPE_CHECKING:
    from physconvex.convex import ConvexField
    from physconvex.identify import PhotometricObservations, Twin
    from physconvex.io import Capture

FRAMES = 6
FILM_NAMES = ("log10_youngs_modulus", "poisson_ratio", "initial_velocity_x", "initial_angular_velocity_y")
FILM_TRUE = np.array([np.log10(2e4), 0.38, 0.2, 0.3])


@pytest.fixture(scope="session")
def box_capture(tmp_path_factory) -> Capture:
    """A capture of a box over a tilted, rough floor; its tracks are those of the reduced model at (20 kPa, .38)."""
    from physconvex.identify import ReducedModel, TwinOptions, base_twin
    from physconvex.io import Capture, Floor, Tracks, load_capture, save_capture
    from physconvex.mesh import TetMesh, box_mesh

    box = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1)
    tets = TetMesh(box.vertices + np.array([0, 0, 0.012]), box.tets)
    points = np.random.default_rng(0).uniform(size=(8, 3)) * [0.3, 0.2, 0.1] + [0, 0, 0.012]
    folder = tmp_path_factory.mktemp("captures")
    floor = Floor(np.zeros(3), np.array([0.1, 0.05, 1.0]), friction=0.3)

    def capture(name: str) -> Capture:
        return Capture(
            folder / name,
            48.0,
            FRAMES,
            FRAMES - 1,
            floor=floor,
            initial_velocity=np.array([0.2, 0, -0.5]),
            initial_angular_velocity=np.zeros(3),
        )

    empty = Tracks(points, np.zeros((FRAMES, 8, 3)), np.full((FRAMES, 8), 1e-4))
    save_capture(capture("first"), tets=tets, tracks=empty)
    twin = base_twin(load_capture(folder / "first"), TwinOptions(weights=3, steps_per_frame=4))
    names = ("log10_youngs_modulus", "poisson_ratio")
    moved = ReducedModel(twin, names, points, FRAMES).positions(np.array([np.log10(2e4), 0.38]))
    moved[2, 3] = np.nan
    save_capture(capture("second"), tets=tets, tracks=Tracks(points, moved, np.full((FRAMES, 8), 1e-4)))
    return load_capture(folder / "second")


@pytest.fixture(scope="session")
def box_twin(box_capture) -> Twin:
    """Its twin, with three weights and four steps per frame."""
    from physconvex.identify import TwinOptions, base_twin

    return base_twin(box_capture, TwinOptions(weights=3, steps_per_frame=4))


@pytest.fixture(scope="session")
def painted_box(box_twin: Twin) -> ConvexField:
    """The box as 12 wedges in random colours, whose harmonics depend on the direction."""
    return painted_wedges(box_twin.mesh.vertices.min(0), box_twin.mesh.vertices.max(0))


@pytest.fixture(scope="session")
def painted_twin(box_twin: Twin, painted_box: ConvexField) -> Twin:
    """The convex twin of these wedges, with three eigenmodes."""
    from physconvex.identify import convex_twin

    surface = box_surface(box_twin.mesh.vertices.min(0), box_twin.mesh.vertices.max(0))
    boxed = replace(box_twin, capture=replace(box_twin.capture, body=surface))
    return convex_twin(boxed, painted_box, "eigenmodes", weights=3)


@pytest.fixture(scope="session")
def box_film(painted_twin: Twin, painted_box: ConvexField) -> PhotometricObservations:
    """What a camera films of the box of the true material, on grey."""
    from physconvex.identify import PhotometricObservations, ReducedModel
    from physconvex.io import look_at
    from physconvex.render import View, render

    camera = look_at((0.5, -0.8, 0.5), (0.2, 0.1, 0.06), width=28, height=24, vertical_field_of_view=0.5)
    grey = np.full((24, 28, 3), 0.4)
    windows = np.tile([1, 23, 2, 26], (FRAMES, 1))
    empty = PhotometricObservations(camera, painted_box, np.zeros((FRAMES, 24, 28, 3)), grey, windows)
    moved = ReducedModel(painted_twin, FILM_NAMES, empty.points, FRAMES).positions(FILM_TRUE)
    images = []
    for points in moved:
        field = empty.field_at(
            torch.as_tensor(points).reshape(painted_box.points.shape), View.of(camera, torch.float64).position
        )
        images.append(render(field, camera, background=torch.as_tensor(grey)).colour.numpy())
    return replace(empty, images=np.stack(images))
