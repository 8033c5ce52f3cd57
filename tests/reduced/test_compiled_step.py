"""The compiled viscosity and contact of a reduced body against plain torch and numpy."""

import pickle

import numpy as np
import pytest
import torch

from physconvex.dynamics import Contact, Plane, Sphere, Timing, simulate
from physconvex.reduced import ReducedBody, ReducedScene, compiled_body as kernel
from physconvex.reduced.compiled_body import CompiledSurface, CompiledViscosity
from physconvex.reduced.surface_contact import SurfaceContact
from tests.kernels.missing import MISSING


def copied(body: ReducedBody) -> ReducedBody:
    return body.with_material(youngs_modulus=body.youngs_modulus)


def moving(body: ReducedBody) -> tuple[torch.Tensor, list[np.ndarray]]:
    """A frozen F*, and velocities and two further directions."""
    rng = np.random.default_rng(0)
    y = body.rest * [0.9, 1.1, 1.05] + 0.02 * rng.normal(size=body.rest.shape)
    return body.deformation_gradient(y), [rng.normal(size=body.rest.shape) for _ in range(3)]


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("law", ["neo_hookean", "corotated"])
def test_viscosity_is_that_of_plain_torch(mixed_body, law, monkeypatch):
    body = mixed_body(2, law)
    plain = copied(body)
    with monkeypatch.context() as patched:
        patched.setattr(kernel, "REDUCED_KERNEL", MISSING)
        assert plain._viscosity is None
    assert isinstance(body._viscosity, CompiledViscosity)
    state, (velocity, step, speed_up) = moving(body)
    power, forces = plain.viscous_energy_and_gradient(state, velocity, 0.03)
    found, pushed = body.viscous_energy_and_gradient(state, velocity, 0.03)
    assert found == pytest.approx(power, rel=1e-12)
    close(pushed, forces)
    other = 2 * body.mu, 0.3 * body.lam
    close(body.viscous_gradient_with(state, velocity, *other), plain.viscous_gradient_with(state, velocity, *other))
    given = (state, velocity, step, speed_up, 0.03)
    close(body.viscous_tangent(*given), plain.viscous_tangent(*given))
    close(body.viscous_blocks(state, 0.7), plain.viscous_blocks(state, 0.7))
    monkeypatch.setattr(kernel, "_BLOCK", 1)  # sample by sample
    close(body.viscous_blocks(state, 0.7), plain.viscous_blocks(state, 0.7))


def test_the_tangent_of_viscosity_is_its_difference(mixed_body):
    body = mixed_body(2)
    state, (velocity, step, speed_up) = moving(body)
    moved = body.deformation_gradient(step)
    ahead, behind = (
        body.viscous_energy_and_gradient(state + s * moved, velocity + s * speed_up, 0.03)[1] for s in (1e-6, -1e-6)
    )
    difference = (ahead - behind) / 2e-6
    found = body.viscous_tangent(state, velocity, step, speed_up, 0.03)
    np.testing.assert_allclose(found, difference, rtol=0, atol=1e-8 * np.abs(difference).max())


def test_viscosity_can_be_sent_to_another_process(mixed_body):
    body = mixed_body(1)
    state, (velocity, *_) = moving(body)
    expected = body.viscous_energy_and_gradient(state, velocity, 0.1)[0]
    assert pickle.loads(pickle.dumps(body)).viscous_energy_and_gradient(state, velocity, 0.1)[0] == expected


def moving_floor(time):
    return np.array([0.0, 0.0, 0.3 * np.sin(3 * time)])


@pytest.mark.parametrize("count", [1, 5, 8, 37])
def test_contact_is_that_of_plain_numpy(count, monkeypatch):
    rng = np.random.default_rng(count)
    values, y = rng.normal(size=(count, 6)), rng.normal(size=(6, 3))
    areas = np.where(rng.uniform(size=count) < 0.2, 0.0, rng.uniform(0.1, 1.0, count))
    obstacles = (
        Plane(point=(0, 0, -0.4), normal=(0.1, 0.2, 1.0), friction=0.3, velocity=moving_floor),
        Sphere(center=(1.0, 0.5, 0.2), radius=2.0, friction=0.1),
    )
    contact = Contact(obstacles, areas, 1e4, 0.05, 1e-3)
    compiled = SurfaceContact(contact, values)
    with monkeypatch.context() as patched:
        patched.setattr(kernel, "REDUCED_KERNEL", MISSING)
        plain = SurfaceContact(contact, values)
    assert isinstance(compiled._compiled, CompiledSurface) and plain._compiled is None
    for time in (0.0, 0.7, 0.7):
        energy, forces = plain.energy_and_gradient(y, time)
        found, pushed = compiled.energy_and_gradient(y, time)
        assert found == pytest.approx(energy, rel=1e-12)
        np.testing.assert_allclose(pushed, forces, rtol=0, atol=1e-12 * max(np.abs(forces).max(), 1e-300))


def test_a_rough_damped_drop_is_the_same_without_a_compiler(mixed_body, monkeypatch):
    body = mixed_body(1)
    floor = Plane(point=(0, 0, body.space.samples.surface_points[:, 2].min() - 0.01), normal=(0.1, 0, 1), friction=0.3)

    def dropped() -> np.ndarray:
        scene = ReducedScene(copied(body), obstacles=(floor,), damping_time=2e-3)
        return simulate(scene, Timing(frames=5, fps=24.0, steps_per_frame=8)).coordinates

    compiled = dropped()
    monkeypatch.setattr(kernel, "REDUCED_KERNEL", MISSING)
    np.testing.assert_allclose(dropped(), compiled, rtol=0, atol=1e-6 * body.space.samples.size)
