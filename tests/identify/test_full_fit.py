"""The full model fitted with its own derivatives, and with what a finer mesh adds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.dynamics import simulate
from physconvex.fem import ElasticBody
from physconvex.identify import (
    FullModel,
    ReducedModel,
    TwinOptions,
    base_twin,
    default_parameters,
    enriched,
    extrapolated_nodes,
    fit,
    fit_finer,
    fit_full,
    marker_observations,
    model_error as finer,
    noise_covariance,
    with_weights,
)
from physconvex.io import Boundary, Capture, Floor, Tracks, load_capture, save_capture
from physconvex.mesh import Embedding, box_mesh, refine_uniformly, to_quadratic
from physconvex.reduced import eigenmode_weights

NAMES, TRUTH, FRAMES = ("log10_youngs_modulus", "poisson_ratio"), np.array([4.6, 0.35]), 6


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """A bar that is clamped at one end and falls; its markers without noise, from a finer mesh."""
    folder = tmp_path_factory.mktemp("bar")
    box = np.array([[-1e-6, -1, -1], [1e-6, 1, 1]])
    points = np.random.default_rng(0).uniform(size=(12, 3)) * [0.2, 0.1, 0.1] + [0.1, 0, 0]
    tets = box_mesh((0.3, 0.1, 0.1), (3, 1, 1), order=1)

    def saved(name, positions):
        tracks = Tracks(points, positions, np.full((FRAMES, 12), 1e-4))
        save_capture(
            Capture(folder / name, 48.0, FRAMES, FRAMES),
            tets=tets,
            tracks=tracks,
            boundary=Boundary(clamped_box=box),
        )
        return load_capture(folder / name)

    empty = saved("empty", np.zeros((FRAMES, 12, 3)))
    twin = base_twin(empty, TwinOptions(weights=3, steps_per_frame=4))
    fine = FullModel(
        twin, NAMES, points, FRAMES, refine_uniformly(refine_uniformly(twin.mesh)), refinement=6
    ).positions(TRUTH)
    capture = saved("seen", fine)
    return base_twin(capture, TwinOptions(weights=3, steps_per_frame=4)), marker_observations(capture)


@pytest.fixture(scope="module")
def fitted(bar):
    """The fit of a reduced model that is much too stiff, three eigenmodes, and the full one's."""
    twin, seen = bar
    twin = with_weights(twin, eigenmode_weights(ElasticBody(twin.mesh), 3))
    start = [p.at(v) for p, v in zip(default_parameters(twin), (4.4, 0.3), strict=True)]
    reduced = fit(ReducedModel(twin, NAMES, seen.points, FRAMES), seen, start)
    return reduced, fit_full(FullModel(twin, NAMES, seen.points, FRAMES), seen, reduced)


def test_the_full_model_comes_nearer_than_the_reduced_one(fitted):
    reduced, found = fitted
    assert found.converged and found.fit.misfit < reduced.misfit
    assert abs(found.fit.values[0] - TRUTH[0]) < 0.5 * abs(reduced.values[0] - TRUTH[0])
    assert found.runs[0].distance > 1e-4 and np.isnan(found.runs[-1].distance)


def test_a_far_start_is_moved_to_a_modulus_that_fits_better(bar, fitted):
    twin, seen = bar
    reduced, near = fitted
    moved = replace(reduced, values=np.array([TRUTH[0] - 0.4, 0.3]))
    found = fit_full(FullModel(twin, NAMES, seen.points, FRAMES), seen, moved)
    np.testing.assert_allclose(found.fit.values, near.fit.values, atol=2e-3)


def test_what_a_finer_mesh_adds_removes_most_of_the_error_and_states_what_is_left(bar, fitted):
    twin, seen = bar
    coarse = FullModel(twin, NAMES, seen.points, FRAMES)
    before = fitted[1].fit
    after = fit_finer(coarse, coarse, refine_uniformly(twin.mesh), seen, before)
    errors = [np.abs(values - TRUTH) for values in (before.values, after.fit.values)]
    assert errors[0][0] > 0.03 and errors[1][0] < 0.1 * errors[0][0]
    noise = np.sqrt(np.diag(noise_covariance(after.fit)))
    assert (after.left > 0).all() and (errors[1] < 2.5 * np.hypot(noise, after.left)).all()
    assert after.left[0] < 0.15 * abs(
        after.fit.values[0] - before.values[0]
    )  # one number tells what the modulus errs by
    assert after.frame_errors[0] < after.frame_errors[-1]


def test_a_fit_on_the_finer_mesh_stays_there_and_a_quarter_of_what_that_changed_counts_as_left(bar, fitted):
    twin, seen = bar
    coarse, before = FullModel(twin, NAMES, seen.points, FRAMES), fitted[1].fit
    fine = replace(coarse, mesh=refine_uniformly(twin.mesh))
    start = [p.at(v) for p, v in zip(before.parameters, before.values, strict=True)]
    found, shorter = (fit(replace(fine, refinement=steps), seen, start) for steps in (1, 2))
    changed = np.abs(found.values - before.values)
    after = fit_finer(fine, coarse, fine.mesh, seen, found)
    assert changed[0] > 0.03
    # by the step's difference alone, and that is its own: of another mesh's it is a fifth less
    moved, expected = after.fit.values - found.values, 4 / 3 * (shorter.values - found.values)
    np.testing.assert_allclose(moved[0], expected[0], rtol=0.02)
    np.testing.assert_allclose(moved[1], expected[1], rtol=0.25)  # frames count otherwise here
    assert after.left[0] == pytest.approx(0.25 * changed[0], rel=0.5)
    assert not after.runs_away


@pytest.mark.wrong_types  # stand-ins for differences of models
def test_differences_that_move_the_values_further_at_every_turn_are_told(bar, fitted, monkeypatch):
    """A lion on its legs: ν from .29 to .19, .09 and its bound."""
    twin, seen = bar
    coarse, before = FullModel(twin, NAMES, seen.points, FRAMES), fitted[1].fit
    tangents = coarse.linearise(before.values)[1]
    steps = np.array([p.step for p in before.parameters])
    ahead, taken = np.array([0.9, 0.0]), []

    def differences(cheap, coarse, finest, observations, values):
        taken.append(values)
        wanted = ahead if len(taken) <= runs else 0.0  # by this the finer model asks for more each time
        return SimpleNamespace(
            anchor=values, finest=seen.positions - np.tensordot(wanted * steps, tangents, ([0], [1])), beyond=0.0,
            tangents=tangents, weighted=seen, errors=np.zeros(FRAMES), share=finer._OTHERWISE,
            by_mesh=None, by_step=None, effect=lambda last, difference: np.zeros(2),
        )  # fmt: skip

    monkeypatch.setattr(finer, "_differences", differences)
    for runs, away in ((3, True), (1, False)):
        taken.clear()
        found = fit_finer(coarse, coarse, None, seen, before)
        assert found.runs_away == away and len(taken) == runs + (not away)
        moved = (found.fit.values - before.values) / steps
        assert moved == pytest.approx(runs * ahead, abs=0.05)


def test_what_halving_the_mesh_changes_is_added_in_part_where_nothing_is_struck(bar):
    """A mesh halved twice is nearer to that than to the mesh halved once; another finer mesh is taken as it is."""
    twin, seen = bar
    coarse = FullModel(twin, NAMES, seen.points, FRAMES)
    halved = replace(coarse, mesh=refine_uniformly(twin.mesh))
    truth = replace(coarse, mesh=refine_uniformly(halved.mesh)).positions(TRUTH)
    nodes = extrapolated_nodes(coarse, halved, TRUTH)
    added = Embedding.of_points(halved.mesh, seen.points).apply(nodes)
    distances = [np.sqrt(np.square(x - truth).sum()) for x in (halved.positions(TRUTH), added)]
    assert distances[1] < 0.6 * distances[0]
    other = replace(coarse, mesh=to_quadratic(box_mesh((0.3, 0.1, 0.1), (4, 2, 2), order=1)))
    np.testing.assert_array_equal(extrapolated_nodes(coarse, other, TRUTH), other.node_positions(TRUTH))
    np.testing.assert_array_equal(extrapolated_nodes(coarse, coarse, TRUTH), coarse.node_positions(TRUTH))


def test_nothing_is_added_where_a_body_may_strike_something(tmp_path):
    """After an impact meshes do not converge to one motion."""
    floor = Floor(np.array([0.0, 0.0, -0.06]), np.array([0.1, 0.0, 1.0]))
    capture = Capture(tmp_path / "thrown", 48.0, 4, 4, floor=floor, initial_velocity=np.array([0.0, 0.0, -1.0]))
    save_capture(capture, tets=box_mesh((0.1, 0.1, 0.1), (1, 1, 1), order=1))
    twin = base_twin(load_capture(capture.folder), TwinOptions(weights=3, steps_per_frame=4))
    coarse = FullModel(twin, NAMES, twin.mesh.vertices[:1], 4)
    halved = replace(coarse, mesh=refine_uniformly(twin.mesh))
    np.testing.assert_array_equal(extrapolated_nodes(coarse, halved, TRUTH), halved.node_positions(TRUTH))


def test_weights_refined_by_the_full_motion_follow_it_more_closely(bar):
    twin = base_twin(bar[0].capture, TwinOptions(weights=10, steps_per_frame=4))
    nodes = simulate(twin.with_values(NAMES, TRUTH).full_scene(), twin.timing(FRAMES)).positions
    fitted = twin.with_values(NAMES, TRUTH)
    gaps = []
    for trial in (fitted, enriched(fitted, nodes)):
        run = simulate(trial.scene, twin.timing(FRAMES))
        gaps.append(np.sqrt(np.square(run.positions(twin.mesh.vertices) - nodes).sum(-1).mean()))
    assert trial.scene.body.space.field.count == 10
    assert gaps[1] < 0.6 * gaps[0]
