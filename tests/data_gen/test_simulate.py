"""The solver's options reach the solver."""

import numpy as np
import pytest

from data_gen import draw_drop, load_config, random_stream, simulate_drop

SMALL = [
    "video={frames: 6, fps: 24, width: 16, height: 16}",
    "motion.drop_height=[0.26, 0.26]",
    "motion.initial_speed=0",
    "motion.size=[0.5, 0.5]",
    "material.youngs_modulus=1000000.0",
    "solver={target_nodes: 200, landing_nodes: 0, steps_per_frame: 8, flight_steps_per_frame: 4}",
]


@pytest.fixture(scope="module")
def runs():
    """One drop of 0.13 m, which takes 3.9 frames: by both contact solvers, with more steps in flight, and landing on
    its shown surface."""
    found = {}
    for name, more in {
        "condensed": [],
        "passes": ["solver.contact_solver=passes"],
        "many": ["solver.flight_steps_per_frame=50"],
        "surface": ["solver.touching=surface"],
    }.items():
        config = load_config("training", overrides=[*SMALL, *more])
        found[name] = simulate_drop(draw_drop(config, 5, 10, 0), config, random_stream(5, 7, 0))
    return found


def test_the_contact_solver_is_what_was_asked_for(runs):
    kept, passes = runs["condensed"].statistics, runs["passes"].statistics
    assert kept.factorisations < 8 < passes.factorisations
    assert np.abs(runs["condensed"].surface - runs["passes"].surface).max() < 0.05


def test_flight_takes_fewer_steps_and_never_more(runs):
    assert runs["condensed"].statistics.halved_steps == 0
    # of the second frame and of the third, at whose end 0.05 m are left, more than meshes of two processors differ by
    assert runs["condensed"].statistics.steps == 5 * 8 - 2 * 4
    assert runs["many"].statistics.steps == 5 * 8


def test_what_is_to_touch_the_floor_does_not_sink_deepest(runs):
    """The mesh of 200 nodes cuts corners of the shown surface, and bulges elsewhere: the other one sinks more."""
    shown, nodes = ({n: float(runs[n].surface[..., 2].min()) for n in runs}, {n: _lowest_node(runs[n]) for n in runs})
    assert nodes["condensed"] > shown["condensed"] + 2e-3
    assert shown["surface"] > nodes["surface"] + 2e-3


def _lowest_node(run):
    return float(run.trajectory.positions[..., 2].min())
