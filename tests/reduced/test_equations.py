"""The incremental potential of a reduced step: gradient and Hessian by finite differences, everything switched on."""

import numpy as np
import pytest

from physconvex.dynamics import Loads, Pins, Plane, Sphere, State, Wind, bdf2, implicit_euler
from physconvex.numerics import NotPositiveDefiniteError
from physconvex.reduced import ReducedBody, ReducedEquations, ReducedScene

STEP = 1e-6


def shaken(body: ReducedBody, seed: int, amount: float) -> np.ndarray:
    return body.rest + amount * np.random.default_rng(seed).normal(size=body.rest.shape)


def full_scene(body: ReducedBody) -> ReducedScene:
    loads = np.random.default_rng(0).normal(size=body.space.samples.surface_points.shape)
    return ReducedScene(
        body,
        obstacles=(
            Plane(point=(0.1, 0, 0.01), normal=(-0.1, 0.0, 1.0), friction=0.5, velocity=(0.2, 0.0, 0.0)),
            Sphere(center=(0.33, 0.0, 0.05), radius=0.06, friction=0.2),
        ),
        damping_time=0.01,
        air_drag=0.7,
        push=lambda t: (t, 0.3, 0.0),
        wind=Wind(lambda t: (2.0, 10 * t, 0.0), drag_coefficient=5.0),
        pins=Pins(body.space.samples.surface_points[:4], 1e-3, motion=lambda t: np.full((4, 3), 0.1 * t)),
        loads=Loads(body.space.samples.surface_points, lambda t: 0.01 * (1 + t) * loads),
        contact_smoothing=0.02,
        slip_velocity=0.3,
    )


def step_equations(body: ReducedBody, *, two_step: bool) -> tuple[ReducedEquations, np.ndarray]:
    """Equations of one time step between random states, and a random point to look at."""
    equations, rng = ReducedEquations(full_scene(body)), np.random.default_rng(3)
    states = [State(0.0, shaken(body, s, 0.004), 0.3 * rng.normal(size=body.rest.shape)) for s in (1, 2)]
    coefficients = bdf2(states[1], states[0], 0.01) if two_step else implicit_euler(states[1], 0.01)
    equations.set_step(coefficients, 0.01, shaken(body, 8, 0.004), states[1])
    return equations, shaken(body, 7, 0.002)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("two_step", [False, True])
def test_gradient_and_hessian_of_the_incremental_potential(mixed_body, order, two_step):
    body = mixed_body(order)
    equations, y = step_equations(body, two_step=two_step)
    assert equations.viscous is not None and len(equations.friction) == 2  # everything is switched on
    _, gradient = equations.evaluate(y)
    hessian = equations.hessian(y)
    equations.factorise(body.rest, project=True)
    at_rest = equations.hessian(body.rest, project=True)
    directions = np.random.default_rng(9).normal(size=(4, *y.shape))
    for d in directions:
        np.testing.assert_allclose(equations.solve((at_rest @ d.ravel()).reshape(d.shape)), d, atol=1e-8)
        solved = equations.exact_solve(y, (hessian @ d.ravel()).reshape(1, *d.shape))[0]
        np.testing.assert_allclose(solved, d, atol=1e-8)
    for d in directions:
        ahead, behind = equations.evaluate(y + STEP * d), equations.evaluate(y - STEP * d)
        assert (gradient * d).sum() == pytest.approx((ahead[0] - behind[0]) / (2 * STEP), rel=1e-5)
        change = (ahead[1] - behind[1]) / (2 * STEP)
        np.testing.assert_allclose(hessian @ d.ravel(), change.ravel(), atol=1e-6 * np.abs(change).max())


def test_indefinite_hessian_is_refused_and_its_projection_is_not(mixed_body):
    body = mixed_body()
    equations = ReducedEquations(full_scene(body))  # no inertia
    squeezed = body.rest * [0.3, 1.0, 1.0] + [10.0, 0, 10.0]
    with pytest.raises(NotPositiveDefiniteError):
        equations.factorise(squeezed, project=False)
    assert not equations.factorised
    projected = equations.hessian(squeezed, project=True)
    assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(projected).max()
