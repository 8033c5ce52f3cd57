"""Rigid drift after a contact: what it does to residuals, and what becomes of a fit."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.dynamics import Plane, Sphere
from physconvex.identify import (
    LinearModel,
    MarginalObservations,
    MarkerObservations,
    Nuisance,
    RigidDriftObservations,
    StackedObservations,
    WeightedObservations,
    default_parameter,
    first_contact,
    fit,
    likely_drift,
    model_drift,
)

FRAMES, INTERVAL, BEGIN, SIGMA = 10, 1 / 24, 4, 1e-3
TIMES = INTERVAL * np.arange(FRAMES)
G = (0.0, 0.0, -9.81)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def falling(rng, count=30):
    """Points that fall and rebound in frame BEGIN."""
    rest = rng.uniform(-0.5, 0.5, (count, 3))
    before = 0.5 * TIMES**2 * G[2]
    height = np.where(np.arange(FRAMES) < BEGIN, before, before[BEGIN] + 1.0 * (TIMES - TIMES[BEGIN]))
    return rest + height[:, None, None] * np.array([0.0, 0.0, 1.0])


def kicked(positions, velocity, spin, frame=BEGIN):
    """The same, flung aside from that frame on."""
    return positions + rigid_change(positions, positions, velocity, spin, frame)


def rigid_change(positions, others, velocity, spin, frame=BEGIN):
    """How far `kicked` moves other points of the body."""
    centre = positions.mean(axis=1, keepdims=True)
    time = np.clip(TIMES - TIMES[frame] + 0.5 * INTERVAL, 0.0, None) * (np.arange(FRAMES) >= frame)
    return time[:, None, None] * (np.asarray(velocity) + np.cross(spin, others - centre))


def markers(positions, rng):
    noise = SIGMA * rng.standard_normal(positions.shape)
    return MarkerObservations(positions[0], positions + noise, np.full(positions.shape[:2], SIGMA))


def bending(positions):
    """Tangents of two made-up parameters: a stretch and a rise that begin with the contact."""
    since = np.clip(TIMES - TIMES[BEGIN - 1], 0.0, None)[:, None, None]
    stretch = since * (positions - positions.mean(axis=1, keepdims=True)) * np.array([1.0, 0.5, -1.0])
    rise = since * np.array([0.0, 0.1, 1.0]) + 0.3 * stretch
    return np.stack([stretch, np.broadcast_to(rise, stretch.shape)], axis=1)


def test_whitened_squares_are_those_of_the_covariance(rng):
    x = falling(rng, count=6)
    seen = markers(x + 0.01 * rng.standard_normal(x.shape), rng)
    drifting = RigidDriftObservations(seen, BEGIN, INTERVAL, 0.02)
    axes, still = np.eye(3), np.zeros(3)
    units = [*((axis, still) for axis in axes), *((still, axis) for axis in axes)]
    directions = np.stack([kicked(x, *unit, frame) - x for frame in range(BEGIN, FRAMES) for unit in units], axis=1)
    arms = x[0] - x[0].mean(axis=0)
    sizes = np.repeat([1.0, 1 / np.sqrt(np.square(arms).sum(-1).mean())], 3)
    slopes = 0.02 * np.tile(sizes, FRAMES - BEGIN) * seen.linearise(x, directions)[1]
    residuals = seen.residuals(x)
    expected = residuals @ np.linalg.solve(np.eye(len(residuals)) + slopes @ slopes.T, residuals)
    assert np.isclose(np.square(drifting.residuals(x)).sum(), expected, rtol=1e-9)
    log_det = np.linalg.slogdet(np.eye(len(residuals)) + slopes @ slopes.T)[1]
    assert np.isclose(drifting.log_likelihood(x), -0.5 * expected - 0.5 * log_det, rtol=1e-9)


def test_derivatives_agree_with_differences(rng):
    x, t = falling(rng, count=8), 0.1
    drifting = RigidDriftObservations(markers(kicked(x, (0.02, 0, 0), (0, 0.04, 0)), rng), BEGIN, INTERVAL, 0.05)
    tangents = bending(x)
    jacobian = drifting.linearise(x, tangents)[1]
    for k in range(2):
        ahead, behind = (drifting.residuals(x + s * 1e-4 * t * tangents[:, k]) for s in (1, -1))
        slope = (ahead - behind) / (2e-4 * t)
        assert np.linalg.norm(jacobian[:, k] - slope) < 1e-2 * np.linalg.norm(slope)  # kicks turn with the arms


def test_a_fit_is_right_although_the_recording_was_flung_aside(rng):
    truth, x = np.array([5.0, 0.3]), falling(rng)
    tangents = bending(x)
    recorded = markers(kicked(x, (0.3, -0.2, 0.4), (0.5, 0.3, -0.2)), rng)
    names = ("log10_youngs_modulus", "poisson_ratio")
    model = LinearModel(names, truth, x, tangents)
    parameters = [default_parameter(n, start=v) for n, v in zip(names, (5.1, 0.35), strict=True)]
    drifting = likely_drift(recorded, x, BEGIN, INTERVAL, most=0.4)
    assert drifting is not None
    plain, found = fit(model, recorded, parameters), fit(model, drifting, parameters)
    deviations = np.sqrt(np.diag(np.linalg.inv(found.jacobian.T @ found.jacobian)))
    assert (np.abs(found.values - truth) < 3 * deviations).all()
    assert (np.abs(plain.values - truth) / deviations).max() > 5
    assert 0.5 < found.reduced_chi_square < 1.5
    far = np.linalg.norm(drifting.drift(x) - (kicked(x, (0.3, -0.2, 0.4), (0.5, 0.3, -0.2)) - x), axis=-1)
    assert far.max() < 0.01
    part, corners = drifting.in_frames(FRAMES - 2), x[:, :4] + np.array([0.3, 0.0, 0.1])  # goes on in the last two
    expected = corners + rigid_change(x, corners, (0.3, -0.2, 0.4), (0.5, 0.3, -0.2))
    assert np.linalg.norm(part.carried(x, corners) - expected, axis=-1).max() < 0.02


def test_six_motions_in_each_frame_say_what_all_kicks_do(rng):
    """A nuisance mixes frames, so that every kick is followed by itself; one that hardly counts changes nothing."""
    x = falling(rng, count=8)
    seen = StackedObservations((markers(kicked(x, (0.1, 0, 0), (0, 0.2, 0)), rng),))
    mixed = MarginalObservations(seen, Nuisance(time_offset=1e-12), INTERVAL)
    short, full = (RigidDriftObservations(s, BEGIN, INTERVAL, 0.05) for s in (seen, mixed))
    for one, other in zip(short.linearise(x, bending(x)), full.linearise(x, bending(x)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * np.abs(other).max())
    assert short.log_likelihood(x) == pytest.approx(full.log_likelihood(x), rel=1e-9)
    np.testing.assert_allclose(short.drift(x), full.drift(x), atol=1e-9)
    mixing = replace(full, seen=MarginalObservations(seen, Nuisance(time_offset=0.01), INTERVAL))
    weighted = replace(mixing, seen=WeightedObservations.by_errors(mixing.seen, np.zeros(FRAMES)))
    assert weighted.log_likelihood(x) == pytest.approx(mixing.log_likelihood(x), rel=1e-9)


def test_where_the_model_follows_no_drift_is_likely(rng):
    x = falling(rng)
    assert likely_drift(markers(x, rng), x, BEGIN, INTERVAL, most=0.4) is None


def test_before_the_contact_nothing_changes(rng):
    x = falling(rng)
    seen = markers(kicked(x, (1, 0, 0), (0, 0, 0)), rng)
    drifting = RigidDriftObservations(seen, BEGIN, INTERVAL, 0.1)
    early = seen.frames < BEGIN
    np.testing.assert_allclose(drifting.residuals(x)[early], seen.residuals(x)[early], rtol=1e-12)
    assert likely_drift(seen.in_frames(BEGIN), x[:BEGIN], BEGIN, INTERVAL, most=0.4) is None


def test_first_contact_is_found_at_a_frame_and_between_frames():
    x = np.zeros((6, 2, 3))
    x[:, 1, 0] = 1.0
    x[:, :, 2] = np.array([0.5, 0.3, 0.12, 0.001, 0.1, 0.2])[:, None]
    times, floor = 0.1 * np.arange(6), Plane()
    assert first_contact(x, [floor], times, (0, 0, 0)) == 3
    x[:, :, 2] = np.array([0.5, 0.3, 0.12, 0.11, 0.3, 0.5])[:, None]  # down to the floor and back between two frames
    assert first_contact(x, [floor], times, (0, 0, 0)) == 3
    assert first_contact(x, [Plane((0, 0, -2))], times, (0, 0, 0)) is None
    assert first_contact(x, [Sphere((0, 0, -1), 1.005)], times, (0, 0, 0)) == 3


def test_the_drift_between_two_models_is_the_kick_that_one_has_and_the_other_has_not(rng):
    x = falling(rng)
    other = kicked(x, (0.3, 0.0, 0.0), (0.0, 0.0, 0.0)) + 1e-5 * rng.standard_normal(x.shape)
    kicks = 6 * (FRAMES - BEGIN)  # one axis of one frame; half of it shows in the frame before the next
    assert model_drift(x, other, BEGIN, INTERVAL) == pytest.approx(0.3 * np.sqrt(0.5 / kicks), rel=0.15)
    assert model_drift(x, x, BEGIN, INTERVAL) < 1e-12


def test_the_drift_of_the_same_positions_is_found_once(rng, monkeypatch):
    positions = falling(rng)
    seen = markers(kicked(positions, (0.02, 0, 0), (0, 0.04, 0)), rng)
    drifting, calls = RigidDriftObservations(seen, BEGIN, INTERVAL, 0.05), []
    settled = RigidDriftObservations._settled
    monkeypatch.setattr(RigidDriftObservations, "_settled", lambda *given: calls.append(1) or settled(*given))
    first = drifting.drift(positions)
    assert np.array_equal(drifting.drift(positions.copy()), first) and len(calls) == 1
    assert np.array_equal(positions + first, drifting.carried(positions, positions)) and len(calls) == 1
    other = drifting.drift(positions * 1.001)
    assert len(calls) == 2 and not np.array_equal(other, first)
    assert np.array_equal(drifting.drift(positions), first)
