"""Many candidates at once against one after the other."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from physconvex.errors import InputError
from physconvex.reduced import Candidates, Plane, ReducedScene, Sphere, simulate, simulate_candidates

MODULI, RATIOS = np.array([8e3, 2e4, 2e4, 1e5]), np.array([0.2, 0.3, 0.45, 0.4])
DAMPING, ROUGHNESS = np.array([0.0, 2e-3, 5e-3, 1e-3]), np.array([0.0, 0.3, 0.8, 0.2])
VELOCITIES = np.array([[0.0, 0.0, -0.5], [0.3, 0.0, -1.0], [0.0, 0.4, 0.0], [0.5, 0.5, -1.0]])
TIMING = {"frames": 5, "fps": 24.0, "steps_per_frame": 6}
CANDIDATES = Candidates(MODULI, RATIOS, DAMPING, ROUGHNESS, VELOCITIES)


def floor(friction: float) -> Plane:
    """Tilted and moving."""
    return Plane(point=(0, 0, -0.01), normal=(0.1, 0.05, 1), friction=friction, velocity=(0.2, 0, 0))


@pytest.fixture
def scene(mixed_body) -> ReducedScene:
    body = mixed_body(youngs_modulus=2e4, poisson_ratio=0.3)
    return ReducedScene(body, obstacles=(floor(0.3),), air_drag=0.3, initial_angular_velocity=(1.0, 0.0, 2.0))


def one_by_one(scene: ReducedScene, number: int) -> np.ndarray:
    body = scene.body.with_material(youngs_modulus=MODULI[number], poisson_ratio=RATIOS[number])
    alone = replace(
        scene,
        body=body,
        obstacles=(floor(float(ROUGHNESS[number])),),
        damping_time=DAMPING[number],
        initial_velocity=VELOCITIES[number],
    )
    return simulate(alone, **TIMING).coordinates


def compare(scene: ReducedScene, device: str) -> None:
    found = simulate_candidates(scene, CANDIDATES, device=device, **TIMING)
    assert not found.failed.any() and found.coordinates.device.type == device
    for number, coordinates in enumerate(found.coordinates.cpu().numpy()):
        np.testing.assert_allclose(coordinates, one_by_one(scene, number), atol=3e-7)
    assert np.ptp(found.coordinates[:, -1].cpu().numpy(), axis=0).max() > 0.05


def test_candidates_move_as_one_after_the_other(scene):
    compare(scene, "cpu")


@pytest.mark.gpu
def test_candidates_on_the_gpu_move_as_one_after_the_other(scene):
    compare(scene, "cuda")


@pytest.mark.parametrize("law", ["neo_hookean", "neo_hookean_log", "corotated"])
def test_laws(mixed_body, law):
    body = mixed_body(law=law, youngs_modulus=2e4, poisson_ratio=0.3)
    start = body.space.affine(np.diag([1.2, 0.9, 1.0]), np.zeros(3))
    damping = 1e-3 if law == "corotated" else 0.0
    scene = ReducedScene(body, initial_coordinates=start, gravity=(0, 0, 0), damping_time=damping)
    found = simulate_candidates(scene, Candidates(2e4, np.array([0.3, 0.3])), **TIMING)
    expected = simulate(scene, **TIMING).coordinates
    np.testing.assert_allclose(found.coordinates[1], expected, atol=1e-7)
    points = body.space.samples.surface_points
    assert found.positions(points).shape == (2, 5, len(points), 3)


def test_a_candidate_that_fails_is_marked_and_no_number(scene):
    candidates = Candidates(np.array([2e4, 2e4]), 0.3, initial_velocity=np.array([[0, 0, 0], [1e200] * 3]))
    found = simulate_candidates(scene, candidates, **TIMING)
    assert found.failed.tolist() == [False, True]
    assert torch.isnan(found.coordinates[1, 1:]).all() and torch.isfinite(found.coordinates[0]).all()


@pytest.mark.wrong_types
def test_what_candidates_cannot_have_is_refused(scene):
    with pytest.raises(InputError, match="spheres"):
        simulate_candidates(replace(scene, obstacles=(Sphere((0, 0, -1), 0.5),)), CANDIDATES)
    with pytest.raises(InputError, match="one length"):
        Candidates(np.ones(2), np.full(3, 0.2))
    with pytest.raises(InputError, match="poisson_ratio"):
        Candidates(1e5, np.array([0.3, 0.5]))
