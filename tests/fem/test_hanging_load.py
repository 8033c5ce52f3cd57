"""A load on a slack string: momentum at the impact, weight at rest, and a smooth dependence on the slack."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import HangingLoad, Loads, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene, solve_static, vibration_modes
from physconvex.mesh import box_mesh

MESH = box_mesh((0.1, 0.02, 0.02), (4, 1, 1), order=1)


def free(ratio: float, slack: float) -> Scene:
    """A block thrown upwards, with a load spread over all of it."""
    body = ElasticBody(MESH, youngs_modulus=1e6, density=1000.0)
    load = HangingLoad(MESH.vertices, ratio * body.node_masses, slack)
    return Scene(body, initial_velocity=(0.0, 0.0, 1.0), hanging=load)


@pytest.mark.parametrize("slack", [0.01, 0.0133])
def test_momentum_is_kept_when_the_string_becomes_taut(slack: float) -> None:
    # body v0 t − g t²/2, load −g t²/2: taut at slack / v0, then M v0 / (M + m) on top of free fall
    run = simulate(free(0.5, slack), Timing(frames=6, fps=100.0, steps_per_frame=8))
    masses = ElasticBody(MESH, density=1000.0).node_masses
    velocity = (run.velocities @ np.array([0, 0, 1.0])) @ masses / masses.sum()
    assert velocity[1] == pytest.approx(1.0 - 9.81 * 0.01, abs=1e-6)
    assert velocity[-1] == pytest.approx(1.0 / 1.5 - 9.81 * 0.05, abs=1e-3)
    height = (run.positions - run.positions[0])[-1, :, 2].mean()
    taut = slack / 1.0
    assert height == pytest.approx(taut + (0.05 - taut) / 1.5 - 0.5 * 9.81 * 0.05**2, abs=2e-4)


def held(load: HangingLoad | None, **changes: object) -> Scene:
    body = ElasticBody(MESH, youngs_modulus=3e5, density=1000.0)
    pins = NodePins(np.flatnonzero(MESH.vertices[:, 0] < MESH.vertices[:, 0].min() + 1e-9))
    return Scene(body, node_pins=pins, hanging=load, damping_time=0.02, **changes)


def tip_masses() -> np.ndarray:
    tip = MESH.vertices[:, 0] > MESH.vertices[:, 0].max() - 1e-9
    return np.where(tip, 0.02 / tip.sum(), 0.0)


def test_a_load_comes_to_rest_where_its_weight_holds() -> None:
    masses = tip_masses()
    run = simulate(held(HangingLoad(MESH.vertices, masses, 0.005)), Timing(frames=40, fps=50.0, steps_per_frame=6))
    weight = masses[:, None] * np.array([0, 0, -9.81])
    rest = solve_static(held(None, loads=Loads(MESH.vertices, weight)))
    assert np.abs(run.positions[-1] - rest).max() < 2e-4
    bare = simulate(held(None), Timing(frames=4, fps=50.0, steps_per_frame=6))
    loose = simulate(held(HangingLoad(MESH.vertices, masses, 1.0)), Timing(frames=4, fps=50.0, steps_per_frame=6))
    np.testing.assert_allclose(loose.positions, bare.positions, atol=1e-9)


def test_without_slack_it_is_thrown_with_the_body() -> None:
    run = simulate(free(0.5, 0.0), Timing(frames=4, fps=100.0, steps_per_frame=8))
    expected = np.broadcast_to([0, 0, 1.0 - 9.81 * 0.03], run.velocities[-1].shape)
    np.testing.assert_allclose(run.velocities[-1], expected, atol=1e-6)


def test_without_slack_it_swings_as_its_modes_say() -> None:
    load, pins = HangingLoad(MESH.vertices, tip_masses()), held(None).node_pins
    body, fixed = held(None).body, np.isin(np.arange(len(MESH.vertices)), pins.nodes)
    (frequency,), (shape,) = vibration_modes(body, 1, clamped=fixed, carried=load.masses)
    assert frequency < 0.6 * vibration_modes(body, 1, clamped=fixed)[0][0]
    start = MESH.vertices + 1e-4 * shape / np.abs(shape).max()
    scene = Scene(body, node_pins=pins, hanging=load, gravity=(0, 0, 0), initial_positions=start)
    run = simulate(scene, Timing(frames=3, fps=2 * frequency, steps_per_frame=64))
    for frame, sign in ((1, -1.0), (2, 1.0)):  # after half a period, and a whole one
        np.testing.assert_allclose(run.positions[frame], MESH.vertices + sign * (start - MESH.vertices), atol=5e-6)


def test_the_motion_depends_smoothly_on_the_slack() -> None:
    tips = []
    for slack in np.linspace(0.004, 0.006, 11):  # over some time steps
        run = simulate(
            held(HangingLoad(MESH.vertices, tip_masses(), slack)), Timing(frames=5, fps=50.0, steps_per_frame=6)
        )
        tips.append(run.positions[-1, :, 2].min())
    change = -np.diff(tips)
    assert (change > 0).all() and change.max() < 4 * change.mean()


def test_bad_loads_are_refused() -> None:
    with pytest.raises(InputError, match=r"hanging\.masses"):
        HangingLoad(MESH.vertices[:4], np.zeros(4))
    with pytest.raises(InputError, match=r"hanging\.slack"):
        HangingLoad(MESH.vertices[:4], np.ones(4), -1.0)
    with pytest.raises(InputError, match=r"hanging\.masses: got shape"):
        HangingLoad(MESH.vertices, np.ones(3))
    with pytest.raises(InputError, match=r"hanging\.points: one lies 0\.1 m from the nearest node"):
        simulate(replace(free(0.5, 0.0), hanging=HangingLoad(MESH.vertices[:1] - 0.1 * np.eye(3)[:1], np.ones(1))))
