"""A rough model is trusted in flight, and after an impact as far as it deserves."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.gap.base import rough_fit
from physconvex.gap.base.rough_fit import with_rough_errors
from physconvex.gap.thresholds import BASE_FIT
from physconvex.identify import TwinOptions, base_twin, marker_observations
from physconvex.io import Capture, Floor, Tracks, save_capture
from physconvex.mesh import TetMesh, box_mesh

FPS, FRAMES, SIZE, HEIGHT = 50.0, 16, 0.1, 0.1


@pytest.fixture(scope="module")
def falling(tmp_path_factory):
    """A cube above a floor, and markers that stay where they were: what they say is not looked at."""
    box = box_mesh((SIZE,) * 3, (1, 1, 1), order=1)
    mesh = TetMesh(box.vertices - box.vertices.min(0) + [0, 0, HEIGHT], box.tets)
    capture = Capture(
        tmp_path_factory.mktemp("rough") / "capture", FPS, FRAMES, 12, gravity=np.array([0, 0, -9.81]),
        density=1000.0, floor=Floor(np.zeros(3), np.array([0.0, 0.0, 1.0])), initial_velocity=np.zeros(3),
        initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    positions = np.repeat(mesh.vertices[None], FRAMES, axis=0)
    save_capture(capture, tets=mesh, tracks=Tracks(mesh.vertices, positions, np.full(positions.shape[:2], 1e-4)))
    twin = base_twin(capture, TwinOptions(weights=4, max_nodes=60, steps_per_frame=6))
    return twin, marker_observations(capture, frames=FRAMES)


def test_noise_is_widened_little_in_flight_and_much_from_the_impact_on(falling):
    twin, seen = falling
    widened = with_rough_errors(seen, twin, FRAMES)
    impact = int(np.ceil(np.sqrt(2 * HEIGHT / 9.81) * FPS))
    flown = 0.5 * 9.81 * (np.arange(impact) / FPS) ** 2
    np.testing.assert_allclose(widened.sigma[:impact, 0], np.hypot(1e-4, 2e-3 * flown), rtol=0.05)
    assert (widened.sigma[impact:] > 0.01 * SIZE).all() and widened.sigma.max() < 0.011 * SIZE


def test_a_contact_between_two_frames_is_seen_by_what_it_does_to_the_velocity(falling, monkeypatch):
    twin, seen = falling
    once = with_rough_errors(seen, twin, FRAMES).sigma[:, 0]
    monkeypatch.setattr(rough_fit, "BASE_FIT", replace(BASE_FIT, near=-1e9))  # never near
    np.testing.assert_allclose(with_rough_errors(seen, twin, FRAMES).sigma[:, 0], once)


def test_fewer_frames_and_nothing_to_strike(falling):
    twin, seen = falling
    assert len(with_rough_errors(seen, twin, 5).sigma) == 5
    free = with_rough_errors(seen, twin.with_scene(obstacles=()), FRAMES)
    assert free.sigma.max() < 0.02 * SIZE and (np.diff(free.sigma[:, 0]) > 0).all()
