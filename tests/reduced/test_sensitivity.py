"""Sensitivities of whole roll-outs against central finite differences."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.dynamics import Timing, simulate, simulate_with_sensitivities
from physconvex.reduced import (
    PARAMETERS,
    NamedParameters,
    ReducedBody,
    ReducedScene,
    parameter_values,
    rollout_positions,
    with_parameters,
)
from tests.reduced.sliding_scene import sliding

# steps of the differences: truncation ~ step² and rounding ~ 1e-11/step, both below 1e-5 of the derivative
STEPS = {
    "log10_youngs_modulus": 1e-5,
    "log10_contact_stiffness": 1e-5,
    "poisson_ratio": 1e-5,
    "density": 1e-2,
    "damping_time": 1e-7,
    "contact_damping": 1e-7,
}
CONSTANTS = ("youngs_modulus", "poisson_ratio", "density")
TIMING = Timing(frames=4, fps=48, steps_per_frame=4, tolerance=1e-11)


def by_differences(scene: ReducedScene, name: str, timing: Timing = TIMING) -> tuple[np.ndarray, np.ndarray]:
    """Central differences of coordinates and velocities at the frames."""
    value, step = parameter_values(scene, [name]), STEPS.get(name.partition("[")[0], 1e-5)
    ahead, behind = (simulate(with_parameters(scene, [name], value + s), timing) for s in (step, -step))
    return tuple((getattr(ahead, f) - getattr(behind, f)) / (2 * step) for f in ("coordinates", "velocities"))


def assert_agree(scene: ReducedScene, names, timing: Timing = TIMING) -> None:
    run = simulate_with_sensitivities(NamedParameters(scene, names), timing)
    assert run.trajectory.statistics.halved_steps == 0
    for i, name in enumerate(names):
        expected = by_differences(scene, name, timing)
        for found, wanted in zip((run.coordinate_tangents, run.velocity_tangents), expected, strict=True):
            error = np.linalg.norm(found[:, i] - wanted) / np.linalg.norm(wanted)
            assert error < 1e-4, (name, error)


def touches(scene: ReducedScene, run) -> np.ndarray:
    """Whether each obstacle is touched at any frame."""
    surface = scene.body.space.surface_values @ run.coordinates
    return np.array(
        [any(o.gap(x, t).min() < 0 for x, t in zip(surface, run.times, strict=True)) for o in scene.obstacles]
    )


@pytest.mark.slow
def test_every_parameter_through_contact_and_friction(mixed_body):
    scene, timing = sliding(mixed_body(2)), replace(TIMING, frames=3)
    assert touches(scene, simulate(scene, timing)).all()
    # a default contact stiffness follows E; named, it does not
    assert_agree(scene, [name for name in PARAMETERS if name != "log10_contact_stiffness"], timing)
    assert_agree(scene, ["log10_contact_stiffness"], timing)


def test_constants_of_regions(mixed_body):
    """E, ν and ρ of each half; the stiffer one leads the contact stiffness, the density moves the centre of mass."""
    body = mixed_body(1)
    cells = np.arange(len(body.density))
    scene = sliding(ReducedBody(body.space, regions=cells % 2, **{n: getattr(body, n) for n in CONSTANTS}), seed=1)
    names = [f"{name}[{region}]" for name in ("log10_youngs_modulus", "poisson_ratio", "density") for region in (0, 1)]
    assert_agree(scene, names)
    values = parameter_values(scene, names)
    np.testing.assert_allclose(parameter_values(with_parameters(scene, names, values * 1.01), names), values * 1.01)
    for bad in (["density[2]"], ["friction[0]"], ["density", "density[0]"]):
        with pytest.raises(InputError, match="parameters"):
            simulate_with_sensitivities(NamedParameters(scene, bad))
    with pytest.raises(InputError, match="regions"):
        ReducedBody(body.space, regions=cells + 1)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["corotated", "neo_hookean_log", "stvk"])
def test_material_of_other_laws(mixed_body, law):
    scene = sliding(mixed_body(1, law), seed=1)
    assert_agree(scene, ["log10_youngs_modulus", "poisson_ratio", "density", "damping_time"])


@pytest.mark.parametrize("options", [{"integrator": "implicit_euler"}, {"friction_passes": 1}, {"friction_passes": 4}])
def test_other_ways_of_stepping(mixed_body, options):
    scene = sliding(mixed_body(1), seed=2)
    names = ["log10_youngs_modulus", "friction", "initial_velocity_x", "gravity_z"]
    assert_agree(scene, names, replace(TIMING, **options))


def test_free_flight_of_an_undamped_body(mixed_body):
    """Damping and drag of zero have derivatives of their own, taken here from one side."""
    scene = sliding(mixed_body(1), obstacles=(), damping_time=0.0, air_drag=0.0, push=None, wind=None)
    assert_agree(scene, ["log10_youngs_modulus", "poisson_ratio", "initial_angular_velocity_y"])
    run = simulate_with_sensitivities(NamedParameters(scene, ["damping_time", "air_drag", "gravity_z"]), TIMING)
    for i, (name, step) in enumerate({"damping_time": 1e-8, "air_drag": 1e-4}.items()):
        ahead = simulate(with_parameters(scene, [name], np.array([step])), TIMING).coordinates
        wanted = (ahead - run.trajectory.coordinates) / step
        assert np.linalg.norm(run.coordinate_tangents[:, i] - wanted) < 1e-3 * np.linalg.norm(wanted), name
    # a uniform field moves every point by t²/2
    points = np.array([[0.1, 0.1, 0.05]])
    t = run.trajectory.times
    np.testing.assert_allclose(
        run.trajectory.carried(points, run.coordinate_tangents)[:, 2, 0, 2], t**2 / 2, atol=0.75 / 192**2
    )


def test_contact_stiffness_named_beside_the_modulus_no_longer_follows_it(mixed_body):
    scene = sliding(mixed_body(1))
    both = simulate_with_sensitivities(
        NamedParameters(scene, ["log10_youngs_modulus", "log10_contact_stiffness"]), TIMING
    )
    alone = simulate_with_sensitivities(NamedParameters(scene, ["log10_youngs_modulus"]), TIMING)
    np.testing.assert_allclose(both.coordinate_tangents.sum(1), alone.coordinate_tangents[:, 0], atol=1e-10)


def test_parameters_are_read_back_as_they_were_set(mixed_body):
    scene = sliding(mixed_body(1))
    values = parameter_values(scene, PARAMETERS)
    moved = values + 0.01 * np.abs(values) + 0.001
    np.testing.assert_allclose(
        parameter_values(with_parameters(scene, PARAMETERS, moved), PARAMETERS), moved, rtol=1e-9
    )


def test_unknown_or_missing_parameters_are_named(mixed_body):
    scene = ReducedScene(mixed_body(1))
    for names in (["youngs"], ["density", "density"], []):
        with pytest.raises(InputError, match="parameters"):
            simulate_with_sensitivities(NamedParameters(scene, names))
    for name in ("friction", "floor_height"):
        with pytest.raises(InputError, match=name):
            simulate_with_sensitivities(NamedParameters(scene, [name]))
    with pytest.raises(InputError, match="values"):
        rollout_positions(torch.zeros(2), scene=scene, parameters=["density"], points=np.zeros((1, 3)))


def test_torch_gradient_of_a_loss_on_positions(mixed_body):
    scene, names = sliding(mixed_body(1)), ["log10_youngs_modulus", "poisson_ratio", "initial_velocity_z"]
    points = np.random.default_rng(0).uniform(size=(5, 3)) * [0.3, 0.2, 0.1]
    target = torch.as_tensor(np.random.default_rng(1).normal(size=(4, 5, 3)))
    values = torch.as_tensor(parameter_values(scene, names))

    def loss(p):
        moved = rollout_positions(p, scene=scene, parameters=names, points=points, timing=TIMING)
        return ((moved - target) ** 2).sum()

    leaf = values.clone().requires_grad_()
    loss(leaf).backward()
    for i in range(3):
        step = 1e-5 * torch.eye(3, dtype=torch.float64)[i]
        assert float(leaf.grad[i]) == pytest.approx(float(loss(values + step) - loss(values - step)) / 2e-5, rel=1e-4)
