"""The fast arithmetic of the neo-Hookean laws against the general one, compiled and not."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from physconvex.materials import MaterialPoints, get_law
from physconvex.reduced import ReducedBody, compiled_body as kernel
from physconvex.reduced.compiled_body import CompiledSamples, volumetric_samples
from physconvex.reduced.volumetric import VolumetricSamples
from tests.kernels.missing import MISSING

LAWS = ["neo_hookean", "neo_hookean_log"]


@pytest.fixture(params=["compiled", "plain"], autouse=True)
def kind(request, monkeypatch):
    """Both arithmetics; without a compiler the plain one is taken."""
    if request.param == "plain":
        monkeypatch.setattr(kernel, "REDUCED_KERNEL", MISSING)
    else:
        assert kernel.REDUCED_KERNEL.available
    return CompiledSamples if request.param == "compiled" else VolumetricSamples


def random_samples(law, count, size, seed=0):
    """What `VolumetricSamples` takes, for so many samples and functions."""
    rng = np.random.default_rng(seed)
    gradients, weights = rng.normal(size=(count, 3, size)), rng.uniform(0.1, 1.0, count)
    return get_law(law), MaterialPoints(gradients, weights, rng.uniform(1.0, 2.0, count), rng.uniform(1.0, 4.0, count))


def near_rest(gradients, amplitude, seed=1):
    """Coordinates whose F is somewhere near the identity at all samples."""
    count, _, size = gradients.shape
    rows = gradients.reshape(3 * count, size)
    rest = np.linalg.lstsq(rows, np.tile(np.eye(3), (count, 1)), rcond=None)[0]
    return rest + amplitude * np.random.default_rng(seed).normal(size=rest.shape)


@pytest.mark.parametrize("law", LAWS)
def test_same_energy_forces_and_hessian_as_the_general_arithmetic(mixed_body, law, kind):
    body = mixed_body(2, law)
    general = ReducedBody(
        body.space,
        law=replace(get_law(law), volumetric=None),  # no fast arithmetic
        youngs_modulus=body.youngs_modulus,
        poisson_ratio=body.poisson_ratio,
        density=body.density,
    )
    assert type(body._quick) is kind and general._quick is None
    for seed, stretch in ((0, [1, 1, 1]), (1, [0.7, 1.3, 1.1])):
        y = body.rest * stretch + 0.002 * np.random.default_rng(seed).normal(size=body.rest.shape)
        energy, forces = general.energy_and_gradient(y)
        found, pushed = body.energy_and_gradient(y)
        assert found == pytest.approx(energy, rel=1e-11)
        np.testing.assert_allclose(pushed, forces, atol=1e-11 * np.abs(forces).max())
        hessian = general.hessian(y)
        np.testing.assert_allclose(body.hessian(y), hessian, atol=1e-10 * np.abs(hessian).max())


def test_a_flattened_body_takes_the_general_arithmetic(mixed_body):
    body = mixed_body(1)
    flat = body.rest * [1.0, 1.0, 0.0]
    assert body._quick is not None and body._quick.hessian_blocks(flat) is None
    assert np.isfinite(body.hessian(flat)).all()


def test_an_overturned_body_has_infinite_energy_under_the_logarithmic_law(mixed_body):
    body = mixed_body(1, "neo_hookean_log")
    assert body.energy_and_gradient(body.rest * [1.0, 1.0, -1.0])[0] == np.inf


def test_a_state_beyond_all_numbers_has_no_finite_energy_and_no_warning(mixed_body):
    body = mixed_body(1)
    assert not np.isfinite(body.energy_and_gradient(1e120 * body.rest)[0])


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("count", "size"), [(1, 4), (7, 8), (19, 13), (40, 44)])
def test_any_number_of_samples_and_functions(law, count, size, kind):
    given = random_samples(law, count, size)
    if size > 3 * count:
        y = near_rest(given[1].gradients, 0.02)
    else:
        directions = given[1].gradients.copy()
        directions[:, :, :3] = np.eye(3) + 0.05 * directions[:, :, :3]
        given = (given[0], replace(given[1], gradients=directions))
        y = np.zeros((size, 3))
        y[:3] = np.eye(3)
        y += 0.01 * np.random.default_rng(2).normal(size=y.shape)
    plain, found = VolumetricSamples(*given), volumetric_samples(*given)
    assert type(found) is kind
    energy, forces = plain.energy_and_gradient(y)
    assert found.energy_and_gradient(y)[0] == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(found.energy_and_gradient(y)[1], forces, atol=1e-12 * np.abs(forces).max())
    softer = given[1].mu / 2, given[1].lam / 3
    expected = plain.energy_and_gradient(y, softer)[1]
    np.testing.assert_allclose(found.energy_and_gradient(y, softer)[1], expected, atol=1e-12 * np.abs(forces).max())
    hessian = plain.hessian_blocks(y)
    np.testing.assert_allclose(found.hessian_blocks(y), hessian, atol=1e-12 * np.abs(hessian).max())
    square = found.hessian_blocks(y).reshape(3 * size, 3 * size)
    np.testing.assert_allclose(square, square.T, atol=1e-12 * np.abs(hessian).max())


def test_where_the_volume_term_is_not_convex(kind):
    law, points = random_samples("neo_hookean_log", 9, 3)
    points = replace(points, gradients=np.tile(np.eye(3), (9, 1, 1)), lam=10 * points.lam)
    y = np.diag([3.0, 3.5, 4.0])  # log J > 1 + μ/λ
    found = volumetric_samples(law, points)
    general = np.zeros((9, 9))
    step = 1e-5
    for n in range(9):
        shift = np.zeros(9)
        shift[n] = step
        ahead, behind = (found.energy_and_gradient(y + s * shift.reshape(3, 3))[1] for s in (1, -1))
        general[:, n] = (ahead - behind).T.ravel() / (2 * step)  # components first
    blocks = found.hessian_blocks(y).reshape(9, 9)
    order = np.arange(9).reshape(3, 3).T.ravel()
    np.testing.assert_allclose(blocks[:, order], general, atol=1e-7 * np.abs(general).max())


def test_samples_can_be_sent_to_another_process(kind):
    given = random_samples("neo_hookean", 5, 6)
    found = volumetric_samples(*given)
    found.energy_and_gradient(np.ones((6, 3)))
    sent = pickle.loads(pickle.dumps(found))
    y = np.random.default_rng(3).normal(size=(6, 3))
    assert type(sent) is kind and sent.energy_and_gradient(y)[0] == found.energy_and_gradient(y)[0]
