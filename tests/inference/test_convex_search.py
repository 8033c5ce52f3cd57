"""The start of the convex twin: the motion before the contact, and E, each with its own height of the floor."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from inference.refinement import convex_start
from inference.refinement.observations import Observed
from inference.refinement.problem import Problem
from physconvex import ConvergenceError
from physconvex.identify import (
    MarkerObservations,
    Parameter,
    ReducedModel,
    StackedObservations,
    TwinOptions,
    base_twin,
    default_parameter,
)
from physconvex.io import Capture, Floor, load_capture, save_capture
from physconvex.mesh import TetMesh, box_mesh

MODULUS, HEIGHT = "log10_youngs_modulus", "floor_height"


def problem(sigma: float) -> SimpleNamespace:
    parameters = (
        Parameter(MODULUS, 5.0, 3.0, 8.0, 0.2),
        Parameter(HEIGHT, 0.0, step=0.01, prior_mean=0.0, prior_sigma=sigma),
    )
    model = SimpleNamespace(positions=lambda values: values.copy())  # as if positions were the values
    return SimpleNamespace(names=(MODULUS, HEIGHT), parameters=parameters, reduced=model)


def valley(_: SimpleNamespace, values: np.ndarray) -> float:
    """A stiffer body on a lower floor rebounds alike; most likely are 5.3 and 4 mm."""
    across, along = (values[0] - 5.3) + 50.0 * (values[1] - 0.004), values[0] - 5.3
    return -400.0 * across**2 - 100.0 * along**2


@pytest.mark.parametrize(("sigma", "modulus"), [(0.005, 5.3), (1e-6, 5.46)])
def test_each_modulus_is_judged_with_its_own_height_of_the_floor(monkeypatch, sigma, modulus):
    """At a height that is held, the maximum along E alone is 0.16 too high."""
    monkeypatch.setattr(convex_start, "_likely", valley)
    run = SimpleNamespace(workers=SimpleNamespace(map=lambda function, values: [function(v) for v in values]))
    found = convex_start._searched(run, problem(sigma), np.array([4.9, 0.0]))
    assert found[0] == pytest.approx(modulus, abs=0.02)
    assert abs(found[1]) <= 2.0 * sigma


def test_heights_beyond_two_deviations_are_not_tried(monkeypatch):
    tried = []

    def lower(_: SimpleNamespace, values: np.ndarray) -> float:
        tried.append(values[1])
        return -1e6 * (values[1] + 0.1) ** 2

    monkeypatch.setattr(convex_start, "_likely", lower)
    likelihood, values = convex_start._at_best_height(problem(0.01), np.array([5.0, 0.0]))
    assert values[1] == pytest.approx(-0.02) and min(tried) >= -0.02 - 1e-9
    assert likelihood == pytest.approx(-1e6 * 0.08**2 - 2.0)


def test_a_body_that_fails_is_the_least_likely():
    def fails(values: np.ndarray) -> np.ndarray:
        raise ConvergenceError("turned inside out")

    broken = problem(0.01)
    broken.reduced.positions = fails
    assert convex_start._at_best_height(broken, np.array([5.0, 0.0]))[0] == -np.inf


def test_the_motion_before_the_contact_is_that_of_the_frames_before_it(tmp_path):
    """A fit of a wrong material that has traded the speed for the rebound: the contact comes two frames too late."""
    box, frames, fps = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1), 10, 48.0
    tets = TetMesh(box.vertices + np.array([0, 0, 0.1]), box.tets)
    still = {"initial_velocity": np.zeros(3), "initial_angular_velocity": np.zeros(3)}
    floor = Floor(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=0.3)
    save_capture(Capture(tmp_path / "box", fps, frames, frames, floor=floor, **still), tets=tets)
    twin = base_twin(load_capture(tmp_path / "box"), TwinOptions(weights=3, steps_per_frame=4))
    names, truth = (MODULUS, "initial_velocity_z", "initial_angular_velocity_x"), np.array([4.3, -0.6, 0.4])
    seen = ReducedModel(twin, names, tets.vertices, frames)
    markers = MarkerObservations(seen.points, seen.positions(truth), np.full((frames, len(seen.points)), 1e-4))
    observed = Observed(StackedObservations.of([markers]), ("markers",))
    problem = Problem(twin, tuple(default_parameter(name) for name in names), observed)
    surface = twin.scene.body.space.samples.surface_points
    model = replace(problem.reduced, points=np.concatenate([problem.reduced.points, surface]))
    given = [np.array([5.2, -0.2, 0.1]), np.array([4.6, 0.0, 0.0])]
    found = convex_start._in_flight(problem, model, given)
    for values, before in zip(found, given, strict=True):
        assert values[0] == before[0]
        assert values[1:] == pytest.approx(truth[1:], abs=1e-3)

    def fails(values: np.ndarray) -> np.ndarray:
        raise ConvergenceError("turned inside out")

    broken = SimpleNamespace(positions=fails)  # others of the candidates may do
    assert convex_start._in_flight(problem, broken, given)[1] is given[1]
    alone = replace(problem, parameters=problem.parameters[:1])
    assert convex_start._in_flight(alone, model, [np.array([5.2])]) == [np.array([5.2])]
