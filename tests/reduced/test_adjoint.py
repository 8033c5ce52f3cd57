"""The adjoint against forward sensitivities and finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Timing, simulate, simulate_with_sensitivities
from physconvex.reduced import PARAMETERS, NamedParameters, ReducedScene, ReducedTrajectory, simulate_with_adjoint
from tests.reduced.sliding_scene import sliding

TIMING = Timing(frames=4, fps=48, steps_per_frame=4, tolerance=1e-11)


def quadratic_loss(run: ReducedTrajectory) -> tuple[float, np.ndarray]:
    target = np.random.default_rng(8).normal(size=run.coordinates.shape)
    difference = run.coordinates - target
    return float((difference**2).sum()), 2 * difference


@pytest.mark.parametrize("options", [{}, {"integrator": "implicit_euler"}, {"friction_passes": 1}])
def test_adjoint_equals_forward_for_every_parameter(mixed_body, options):
    scene = sliding(mixed_body(1), seed=4)
    names = [name for name in PARAMETERS if name != "log10_contact_stiffness"]
    found = simulate_with_adjoint(scene, quadratic_loss, replace(TIMING, **options), parameters=names)
    forward = simulate_with_sensitivities(NamedParameters(scene, names), replace(TIMING, **options))
    value, slope = quadratic_loss(forward.trajectory)
    expected = np.einsum("tpri,tri->p", forward.coordinate_tangents, slope)
    assert found.loss == pytest.approx(value)
    np.testing.assert_allclose(found.named, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


def test_fields_by_finite_differences(mixed_body):
    """E and ν of single cells at fixed contact stiffness, and the initial coordinates of a spinning body."""
    body = mixed_body(1)
    scene = sliding(body, seed=4, contact_stiffness=1e6)
    found = simulate_with_adjoint(scene, quadratic_loss, TIMING)

    def difference(make, step: float) -> float:
        ends = [quadratic_loss(simulate(make(s), TIMING))[0] for s in (step, -step)]
        return (ends[0] - ends[1]) / (2 * step)

    cell = np.eye(len(body.youngs_modulus))[3]
    for name, step in (("youngs_modulus", 0.1), ("poisson_ratio", 1e-5), ("density", 0.1)):

        def changed(s: float, name: str = name) -> ReducedScene:
            return replace(scene, body=body.with_material(**{name: getattr(body, name) + s * cell}))

        assert getattr(found, name)[3] == pytest.approx(difference(changed, step), rel=1e-4), name
    push = np.random.default_rng(2).normal(size=body.rest.shape)
    expected = difference(
        lambda s: replace(scene, initial_coordinates=scene.start + s * push, initial_orientation=(0, 0, 0)), 1e-7
    )
    assert (found.initial_coordinates * push).sum() == pytest.approx(expected, rel=1e-4)


def test_sum_over_cells_is_the_derivative_of_the_whole(mixed_body):
    scene = sliding(mixed_body(1), seed=4, contact_stiffness=1e6)
    names = ["log10_youngs_modulus", "poisson_ratio", "density"]
    found = simulate_with_adjoint(scene, quadratic_loss, TIMING, parameters=names)
    whole = np.log(10) * (found.youngs_modulus * scene.body.youngs_modulus).sum()
    heavier = (found.density * scene.body.density).sum() / (scene.body.total_mass / scene.body.volume)
    np.testing.assert_allclose([whole, found.poisson_ratio.sum(), heavier], found.named, rtol=1e-8)


def test_a_derivative_of_the_wrong_shape_is_named(mixed_body):
    with pytest.raises(InputError, match="loss"):
        simulate_with_adjoint(
            sliding(mixed_body(1), seed=4), lambda run: (0.0, np.zeros(3)), Timing(frames=2, steps_per_frame=1)
        )
