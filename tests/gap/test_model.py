"""The twin with effects of the clock: what is seen between the frames and beyond the last one."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, GapOptions, error_model
from physconvex.gap.base.model import reduced_like
from physconvex.gap.errors.numerical_differences import Numerics, exact_model
from physconvex.gap.search.full_order import with_own_correction
from physconvex.gap.search.hypothesis import base_hypothesis
from physconvex.mesh import TetMesh, box_mesh

FRAMES, FPS, SIZE = 14, 40.0, 0.14  # of the fixture `dropped_box`
UP = np.array([0.0, 0.0, 0.5 * SIZE + 0.05])


def effects(*names):
    return tuple(next(e for e in DEFAULT_EFFECTS if e.name == name) for name in names)


@pytest.fixture
def base(dropped_box):
    """Of a box that strikes the floor in the middle of a frame."""
    return dropped_box


@pytest.mark.parametrize("name", ["time_scale", "time_offset"])
@pytest.mark.parametrize("reduced", [False, True], ids=["full", "reduced"])
def test_a_wrong_clock_sees_what_a_run_by_that_clock_shows(base, name, reduced):
    model = replace(base.model, effects=effects(name), reduced=reduced)
    steps = model.twin.steps_per_frame
    first, every, dose = (0, steps + 1, 1 / steps) if name == "time_scale" else (4, steps, 4 / steps / FPS)
    values = np.append(base.fit.values, dose)
    by_step = replace(model.twin, capture=replace(model.twin.capture, fps=steps * FPS), steps_per_frame=1)
    whole = replace(model, twin=by_step, effects=(), frames=steps * (FRAMES + 2)).motion(base.fit.values)
    exact = whole.positions[first::every][:FRAMES]
    np.testing.assert_allclose(model.positions(values), exact, atol=1e-6 * SIZE)
    by_frames = model.observed(replace(model.motion(values), steps=None), values)
    assert np.abs(by_frames - exact).max() > 0.005 * SIZE


def test_what_only_the_clock_changes_needs_a_run_only_where_it_looks_further(base):
    model = replace(base.model, effects=effects("camera_pose", "time_offset"))
    values = model.null_values()
    values[: len(base.fit.values)] = base.fit.values
    motion, spent = model.motion(values), model.cost.spent
    other = values.copy()
    other[-1] = -0.01
    assert np.abs(model.signature(other, values, motion)).max() > 0 and model.cost.spent == spent
    other[-1] = 0.01
    further = model.signature(other, values, motion)
    assert model.cost.spent > spent
    np.testing.assert_allclose(further, model.positions(other) - model.positions(values), atol=1e-12)


def test_derivatives_by_the_clock_are_the_velocities(base):
    model = replace(base.model, effects=effects("time_offset"))
    values = np.append(base.fit.values, 0.0)
    motion = model.motion(values)
    tangents = model.linearise(values, motion)[1][:, -1]
    step = 1e-6
    exact = (motion.at(motion.times + step) - motion.at(motion.times - step)) / (2 * step)
    flying = slice(1, 4)
    np.testing.assert_allclose(tangents[flying], exact[flying], atol=0.02 * np.abs(exact).max())


def test_a_fit_with_its_own_correction_moves_as_the_most_exact_run_does(base):
    """At the frames and between them, by the full-order model and by the reduced one that is searched."""
    box = box_mesh((0.1, 0.1, SIZE), (2, 2, 3), order=2)
    mesh, still = TetMesh(box.vertices + UP, box.tets), np.zeros_like(base.motion.positions)
    numerics = Numerics(*[still] * 5, exact=(mesh, still))
    errors = error_model(base, numerics, GapOptions())
    found = base_hypothesis(base, errors)
    own = with_own_correction(base, errors, numerics, found)
    exact = exact_model(base.model, mesh).motion(base.fit.values)
    assert np.abs(own.positions - found.positions).max() > 0.005 * SIZE
    np.testing.assert_allclose(own.positions, exact.positions, atol=1e-12)
    cheap, motion = reduced_like(own.model, own.motion, own.values)
    between = (motion.times[:-1] + 0.4 / FPS).astype(float)
    for model, moved in ((own.model, own.motion), (cheap, motion)):
        corrected = model.correction.of(moved)
        np.testing.assert_allclose(corrected.positions, exact.positions, atol=1e-12)
        seen = corrected.at(np.append(between, corrected.times[-1]))[:-1]
        np.testing.assert_allclose(seen, exact.at(np.append(between, exact.times[-1]))[:-1], atol=1e-3 * SIZE)
    assert with_own_correction(base, errors, replace(numerics, exact=None), found) is found
