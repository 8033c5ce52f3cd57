"""Falls as the training holds them: their states, and one world made of two."""

import dataclasses

import numpy as np
import pytest
import torch

from data_gen import lay_out, roll_out
from models import STATE_NAMES, STATE_SCALE, dimensionless_interval, log10_dimensionless_stiffness
from physconvex import ConvergenceError
from physconvex.mesh import Embedding, sample_interior
from train import simulate_falls
from train.falls.world import joined, turned
from train.motion_states import states_of_motion


def test_labels_are_the_bodies(bodies, falls):
    assert len(falls) == 2
    for body in bodies:
        k = int((falls.size - body.size).abs().argmin())
        wanted = log10_dimensionless_stiffness(body.youngs_modulus, density=1000.0, object_size=body.size)
        assert float(falls.log10_stiffness[k]) == pytest.approx(wanted, abs=1e-5)
        assert float(falls.interval[k]) == pytest.approx(dimensionless_interval(24.0, object_size=body.size), abs=1e-6)


@pytest.mark.parametrize("azimuth", [0.0, 0.8])
def test_states_are_those_of_points_inside(finer_body, azimuth):
    """Against `train.motion_states.states_of_motion` of interior samples, seen from another side."""
    body, falls = finer_body, simulate_falls([finer_body], frames=14)
    turn = np.array([[np.cos(azimuth), -np.sin(azimuth), 0], [np.sin(azimuth), np.cos(azimuth), 0], [0, 0, 1]])
    found = turned(falls.states, torch.from_numpy(turn).float()[None])[0].numpy()
    mesh = body.mesh()
    points, weights = sample_interior(mesh, 4000, np.random.default_rng(0))
    moved = Embedding.of_points(mesh, points).apply(falls.body(0).double().numpy())
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    wanted = states_of_motion(
        ((points - centre) @ turn.T / body.size).astype(np.float32),
        ((moved - points) @ turn.T / body.size).astype(np.float32),
        weights,
        height=centre[2] / body.size,
    )
    error = np.abs(found - wanted) / STATE_SCALE.numpy()
    quantiles = [STATE_NAMES.index("lowest"), STATE_NAMES.index("height")]  # of few points in a few elements
    assert error[:, quantiles].max() < 0.25
    assert np.delete(error, quantiles, axis=1).max() < 0.05


def test_two_worlds_in_one(bodies, falls):
    parts = [simulate_falls([body], frames=falls.frames) for body in bodies]
    both = joined(parts)
    assert len(both) == 2
    for k, part in enumerate(parts):
        assert torch.equal(both.body(k), part.body(0))
        triangle = both.clips[k, 2]
        assert torch.equal(both.triangles[triangle : triangle + both.clips[k, 3]], part.triangles)


def test_what_becomes_unstable_is_tried_with_shorter_steps(bodies, monkeypatch):
    """A body of which too few stages are made explodes; cautious steps are short enough for them."""
    asked: list[float] = []

    def laid(given, **options):
        asked.append(options["caution"])
        layout = lay_out(given, **options)
        if options["caution"] == 1.0:
            layout.materials[:, 3] *= 1e6  # a floor too stiff for its steps
        return layout

    monkeypatch.setattr("train.falls.world.lay_out", laid)
    falls = simulate_falls(bodies[:1], frames=16)
    assert asked == [1.0, 3.0] and len(falls) == 1
    assert bool(falls.positions.isfinite().all())
    usual = lay_out(bodies[:1], frames=16)
    assert torch.allclose(falls.body(0), usual.positions(roll_out(usual), 0), atol=5e-3)


def test_no_stable_fall_is_an_error(bodies, monkeypatch):
    def laid(given, **options):
        layout = lay_out(given, **options)
        layout.materials[:, 3] *= 1e6
        return layout

    monkeypatch.setattr("train.falls.world.lay_out", laid)
    with pytest.raises(ConvergenceError, match="none of 1 falls"):
        simulate_falls(bodies[:1], frames=16)


def test_bodies_are_not_changed(bodies):
    assert all(dataclasses.is_dataclass(body) for body in bodies)
    with pytest.raises(dataclasses.FrozenInstanceError):
        bodies[0].size = 1.0


@pytest.mark.slow
def test_processes_lay_out_the_same(bodies):
    alone, shared = (lay_out(bodies, frames=16, workers=workers) for workers in (0, 2))
    for name in ("table", "materials", "geometry", "corners", "nodes", "start", "out"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(alone, name))
