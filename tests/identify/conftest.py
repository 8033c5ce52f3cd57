"""A small dropped box: its twin, and markers that were made with it.

The imports are inside the fixtures: `--typecheck` wants to be there before the packages are imported.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from physconvex.identify import Twin
    from physconvex.io import Capture

FRAMES = 6


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
