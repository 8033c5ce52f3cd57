"""Derivatives of roll-outs of bodies that flow, against central differences of whole roll-outs."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Plane, Timing, simulate, simulate_with_sensitivities
from physconvex.materials import FlowRule, Plasticine, Sand, StandardLinearSolid
from physconvex.reduced import (
    NamedParameters,
    ReducedBody,
    ReducedScene,
    parameter_values,
    simulate_with_adjoint,
    with_parameters,
)

COMMON = ("log10_youngs_modulus", "poisson_ratio", "initial_velocity_x")
STEPS = {"yield_stress": 1e-3, "relaxation_time": 1e-7}
TIMING = Timing(frames=4, fps=60, steps_per_frame=4, tolerance=1e-11)
CASES = [
    (Plasticine(400.0), ("yield_stress", "friction")),
    (Plasticine(400.0, "neo_hookean"), ("yield_stress",)),
    (Sand(0.5), ("friction_angle",)),
    (StandardLinearSolid(1.5, 0.02), ("modulus_ratio", "relaxation_time", "damping_time")),
]


def thrown(space_of, flow: FlowRule) -> ReducedScene:
    """A block that hits a tilted, rough floor and slides on it."""
    body = ReducedBody(space_of(), youngs_modulus=2e4, poisson_ratio=0.3, flow=flow)
    floor = Plane(point=(0, 0, -2e-3), normal=(0.05, 0.02, 1), friction=0.3)
    start = body.space.affine(np.array([[1.02, 0.05, 0.0], [0.0, 0.97, 0.01], [0.0, 0.02, 0.98]]), np.zeros(3))
    return ReducedScene(
        body,
        obstacles=(floor,),
        initial_coordinates=start,
        initial_velocity=(0.4, 0.1, -1.0),
        damping_time=2e-3,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("flow", "own"), CASES, ids=lambda case: type(case).__name__)
def test_sensitivities_through_the_stored_deformation(space_of, flow, own):
    scene, names = thrown(space_of, flow), (*COMMON, *own)
    run = simulate_with_sensitivities(NamedParameters(scene, names), TIMING)
    assert run.trajectory.statistics.halved_steps == 0
    assert np.abs(run.trajectory.flowed[-1] - np.eye(3)).max() > 0.01
    for i, name in enumerate(names):
        value, step = parameter_values(scene, [name]), STEPS.get(name, 1e-6)
        ahead, behind = (simulate(with_parameters(scene, [name], value + s), TIMING) for s in (step, -step))
        expected = (ahead.coordinates - behind.coordinates) / (2 * step)
        error = np.linalg.norm(run.coordinate_tangents[:, i] - expected) / np.linalg.norm(expected)
        assert error < 1e-4, (name, error)


def test_a_constant_of_another_rule_and_the_adjoint_are_refused(space_of):
    scene = thrown(space_of, Plasticine(400.0))
    with pytest.raises(InputError, match="friction_angle"):
        simulate_with_sensitivities(NamedParameters(scene, ["friction_angle"]))
    with pytest.raises(InputError, match="body flows"):
        simulate_with_adjoint(scene, lambda run: (0.0, run.coordinates))
