"""What runs of other meshes say of the error of the one that is used."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import GapOptions, PointMotion, correction_of, error_model
from physconvex.gap.base.body_modes import body_modes
from physconvex.gap.errors.error_model import path_since_contact
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.identify import MarkerObservations

STILL = np.zeros((4, 3, 3))
NODES = (250, 1000)
BY_COARSER, BY_FINER = 1 / (4 ** (1.75 / 3) - 1), 2.5 ** (1.75 / 3) / (2.5 ** (1.75 / 3) - 1)


def mesh_error(coarser, finer):
    finest = None if finer is None else STILL + finer
    numerics = Numerics(STILL, STILL + coarser, STILL, STILL, STILL, nodes=NODES, finest=finest)
    return numerics.null[1]


def test_richardson_with_either_mesh():
    """Of an error that falls with nodes^(-1.75/3), both differences give what the used mesh errs by."""
    errors = {n: n ** (-1.75 / 3) for n in (250, 1000, 2500)}
    coarser, finer = errors[250] - errors[1000], errors[1000] - errors[2500]
    assert mesh_error(coarser, None) == pytest.approx(STILL + errors[1000])
    assert coarser * BY_COARSER == pytest.approx(errors[1000]) and finer * BY_FINER == pytest.approx(errors[1000])


def test_the_lesser_estimate_is_believed():
    assert mesh_error(10.0, 0.1) == pytest.approx(STILL + 0.1 * BY_FINER)  # the coarse mesh flew on otherwise
    assert mesh_error(0.1, 10.0) == pytest.approx(STILL + 0.1 * BY_COARSER)  # the finest did


@pytest.mark.wrong_types
def test_what_the_most_exact_run_changes_is_added_and_only_what_it_errs_by_is_left():
    errors, by_steps = {n: n ** (-1.75 / 3) for n in (250, 1000, 2500)}, 0.3
    finest = STILL + errors[1000] - errors[2500]
    numerics = Numerics(
        STILL, STILL + errors[250] - errors[1000], STILL, STILL, STILL, nodes=NODES, finest=finest,
        exact=(None, finest + by_steps), fine=(None, None),
    )  # fmt: skip
    assert correction_of(numerics).positions == pytest.approx(finest + by_steps)
    assert numerics.null[0] == pytest.approx(STILL + 0.2 * by_steps)
    assert numerics.null[1] == pytest.approx(STILL + errors[2500])


@pytest.mark.wrong_types
@pytest.mark.parametrize(("friction", "sideways"), [(None, 1.0), (0.0, 0.2), (0.3, 0.5), (2.0, 1.0)])
def test_a_rebound_may_be_off_by_a_hundredth_of_its_way(rng, friction, sideways):
    """As a whole, from the frame of the first contact on; strains, of which this body has none, are not widened.

    Across the normal of a floor, if that is known, by less, the smoother it is.
    """
    frames, points, sigma = 8, 20, 1e-4
    rest = rng.normal(size=(points, 3))
    height = np.abs(np.linspace(1.0, -0.75, frames))
    positions = rest + height[:, None, None] * np.array([0, 0, 1.0])
    motion = PointMotion(rest, np.arange(frames) / 10, positions, np.zeros_like(positions))
    seen = MarkerObservations(rest, positions, np.full((frames, points), sigma))
    force = np.where(np.arange(frames) == 4, 1.0, 0.0)
    modes = body_modes(seen, free=True, force=force, normal=None if friction is None else np.array([0.0, 0.0, 1.0]))
    base = SimpleNamespace(
        positions=positions, motion=motion, observations=seen, modes=modes, contact_force=force,
        tangents=np.zeros((0,)), model=SimpleNamespace(frames=frames),
        situation=SimpleNamespace(friction=friction or 0.0),
        change=lambda moved: modes.turn(seen.residuals(moved) - seen.residuals(positions)),
    )  # fmt: skip
    nothing = np.zeros_like(positions)
    numerics = Numerics(*[nothing] * 5)
    errors = error_model(base, numerics, GapOptions(discretisation=1e-9))
    numerical = errors.expected - 1.0
    path = path_since_contact(motion, force)
    for frame in range(frames):
        own = (seen.frames == frame) & (modes.parts[modes.kinds] == 0)
        squares = points * (0.01 * path[frame] / sigma) ** 2 if frame >= 4 else 0.0
        shares = np.ones(6)  # of the six rigid motions
        shares[:2] = sideways**2
        assert numerical[own] == pytest.approx(squares / 6 * shares, rel=1e-6, abs=1e-6)
    assert numerical[modes.parts[modes.kinds] > 0] == pytest.approx(0, abs=1e-6)
