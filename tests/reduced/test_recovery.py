"""Known constants → motion → wrong start → the constants again, by Gauss–Newton on the sensitivities."""

import numpy as np

from physconvex.dynamics import Plane, Timing, simulate, simulate_with_sensitivities
from physconvex.reduced import NamedParameters, ReducedBody, ReducedScene, parameter_values, with_parameters


def test_modulus_ratio_and_velocity_are_recovered_from_marker_tracks(space_of):
    names = ["log10_youngs_modulus", "poisson_ratio", "initial_velocity_z"]
    body = ReducedBody(space_of(), youngs_modulus=2e4, poisson_ratio=0.38)
    floor = Plane(point=(0, 0, -0.01), normal=(0.1, 0.05, 1.0), friction=0.3)
    truth = ReducedScene(body, obstacles=(floor,), initial_velocity=(0.2, 0, -0.5))
    timing = Timing(frames=6, fps=48, steps_per_frame=4, tolerance=1e-9)
    markers = np.random.default_rng(0).uniform(size=(8, 3)) * [0.3, 0.2, 0.1]
    observed = simulate(truth, timing).positions(markers)
    wanted = parameter_values(truth, names)
    values = wanted + np.array([0.2, -0.1, 0.1])
    for _ in range(7):
        run = simulate_with_sensitivities(NamedParameters(with_parameters(truth, names, values), names), timing)
        residual = (run.trajectory.positions(markers) - observed).ravel()
        jacobian = np.moveaxis(run.trajectory.carried(markers, run.coordinate_tangents), 1, -1).reshape(
            len(residual), -1
        )
        values = values - np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    np.testing.assert_allclose(values, wanted, atol=1e-6)
    assert np.abs(residual).max() < 1e-4


def test_what_the_motion_cannot_tell_has_no_sensitivity(space_of):
    """A body in free fall from rest tells nothing of its material."""
    scene = ReducedScene(ReducedBody(space_of(), youngs_modulus=2e4))
    run = simulate_with_sensitivities(
        NamedParameters(scene, ["log10_youngs_modulus", "poisson_ratio", "density"]), Timing(frames=3)
    )
    assert np.abs(run.coordinate_tangents).max() < 1e-9
