"""Frequency and damping of signals; rigid motion of markers; noise of the first frame."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.gap.base.baseline import Split
from physconvex.gap.base.observed_points import _check_on_body, starts_elsewhere, with_honest_noise
from physconvex.gap.location.body_motion import _rigid_motion
from physconvex.gap.search.damped_sine import damped_sine_fit, damped_sine_likelihood, deformation
from physconvex.identify import MarkerObservations
from physconvex.io import Capture
from physconvex.mesh import box_mesh


def test_a_damped_sine_is_found():
    times = np.arange(30) / 100
    omega = 2 * np.pi * 7.0
    signal = 0.02 * np.exp(-0.08 * omega * times) * np.cos(omega * times + 0.4) + 0.005
    (frequency, ratio), errors = damped_sine_fit(signal + 1e-5 * np.random.default_rng(0).normal(size=30), 100.0)
    assert frequency == pytest.approx(7.0, rel=0.01) and ratio == pytest.approx(0.08, rel=0.05)
    assert 0 < errors[0] < 0.1


def test_a_ramp_does_not_ring():
    assert np.isnan(damped_sine_fit(np.linspace(0, 1, 20), 50.0)[0]).all()
    assert np.isnan(damped_sine_fit(np.zeros(20), 50.0)[0]).all()


def swinging(frequency: float, ratio: float, late: float = 0.0) -> np.ndarray:
    """A tip of three markers that swings about where it hangs, from some time on."""
    times = np.maximum(np.arange(45) / 100 - late, 0.0)
    omega = 2 * np.pi * frequency
    height = -0.01 * (1 - np.exp(-ratio * omega * times) * np.cos(omega * times))
    return np.stack([np.zeros((45, 3)), np.zeros((45, 3)), np.outer(height, [1.0, 0.99, 0.97])], axis=-1)


def test_an_explanation_that_rings_otherwise_is_the_worse_one():
    rest = np.zeros((3, 3))
    seen = swinging(3.4, 0.07) + 1e-5 * np.random.default_rng(1).normal(size=(45, 3, 3))
    base = SimpleNamespace(
        observations=MarkerObservations(rest, seen, np.full((45, 3), 1e-5)),
        situation=SimpleNamespace(clamped=True),
        motion=SimpleNamespace(rest=rest),
        split=Split(np.arange(30), np.arange(30, 38), np.arange(0)),
        capture=SimpleNamespace(fps=100.0),
    )
    right = damped_sine_likelihood(base, swinging(3.4, 0.07, late=0.02))  # whatever began the motion and when
    elastic = damped_sine_likelihood(base, swinging(3.4, 0.0))
    overdamped = damped_sine_likelihood(base, swinging(3.6, 0.31))
    another_frequency = damped_sine_likelihood(base, swinging(4.8, 0.0))
    assert -0.6 < right <= 0
    assert -4 < elastic < right - 1
    assert overdamped < elastic - 10 and another_frequency < elastic - 10
    base.situation.clamped = False
    assert damped_sine_likelihood(base, swinging(4.8, 0.0)) == 0.0


def test_rigid_motion_of_markers():
    rng = np.random.default_rng(1)
    cloud, times = rng.normal(size=(9, 3)), np.arange(9) / 200
    turned = []
    for t in times:
        c, s = np.cos(2 * t), np.sin(2 * t)
        turned.append(cloud @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + np.array([1.0, 0, -0.5]) * t)
    centre, velocity, spin = _rigid_motion(np.stack(turned), 200.0)
    np.testing.assert_allclose(
        velocity[4] - np.cross([0, 0, 2.0], turned[4].mean(0) - [0.02, 0, -0.01]), [1, 0, -0.5], atol=1e-3
    )
    np.testing.assert_allclose(spin[4], [0, 0, 2.0], atol=1e-3)
    np.testing.assert_allclose(deformation(np.stack(turned), cloud, held=False), 0, atol=1e-12)
    assert centre.shape == (9, 3)


def test_noise_is_no_smaller_than_in_the_first_frame():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(30, 3))
    noisy = points + 0.01 * rng.normal(size=(4, 30, 3))
    assert with_honest_noise(MarkerObservations(points, noisy, np.full((4, 30), 1e-3))).sigma[2, 3] == pytest.approx(
        0.01, rel=0.3
    )
    honest = MarkerObservations(points, noisy, np.full((4, 30), 0.01))
    assert with_honest_noise(honest) is honest
    few = MarkerObservations(points[:4], noisy[:, :4], np.full((4, 4), 1e-3))
    assert with_honest_noise(few) is few


def test_markers_off_the_body_are_refused(tmp_path):
    mesh = box_mesh((0.2, 0.1, 0.1), (2, 1, 1), order=2)
    capture = Capture(tmp_path, 100.0, 12, 8)
    _check_on_body(capture, mesh.vertices + 0.01, mesh)
    with pytest.raises(InputError, match=r"rest\[0\] lies 4\.8 m outside"):
        _check_on_body(capture, np.array([[5.0, 0.0, 0.0]]), mesh)


def test_a_moved_camera_is_no_noise():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(30, 3))
    moved = np.repeat((points + np.array([0.1, 0, 0.02]))[None], 3, axis=0) + 1e-3 * rng.normal(size=(3, 30, 3))
    seen = MarkerObservations(points, moved, np.full((3, 30), 1e-3))
    assert with_honest_noise(seen) is seen and starts_elsewhere(seen)
    still = points + 1e-3 * rng.normal(size=(3, 30, 3))
    assert not starts_elsewhere(MarkerObservations(points, still, np.full((3, 30), 1e-3)))
