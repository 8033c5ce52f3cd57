"""Effects told by the flight, E found beside them where the base fit has another one, and what is expected there."""

import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.gap import DEFAULT_EFFECTS, ErrorModel, GapOptions, rough_baseline
from physconvex.gap.base.model import MODULUS
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.search import starting_points
from physconvex.gap.search.full_order import as_reduced
from physconvex.gap.search.hypothesis import base_hypothesis
from physconvex.gap.search.search_state import EffectSearch
from physconvex.gap.search.selection import expect_anew
from physconvex.gap.search.starting_points import from_flight
from physconvex.gap.thresholds import SEARCH
from physconvex.io import Capture, Floor, Tracks, load_capture, save_capture
from physconvex.mesh import TetMesh, box_mesh

OPTIONS = GapOptions(max_nodes=60, weights=4, iterations=6)
TRUE, FRAMES, FPS, TILT = 5e4, 24, 60.0, np.radians(4.0)
EFFECTS = tuple(e for e in DEFAULT_EFFECTS if e.name in ("gravity_tilt", "air_drag"))


def dropped(folder, tilt, height):
    """A box falls by `height` [m] along a tilted gravity, its markers followed; the capture says that it is upright."""
    mesh = box_mesh((0.1, 0.1, 0.14), (1, 1, 1), order=2)
    corners = box_mesh((0.1, 0.1, 0.14), (1, 1, 1), order=1)
    up = np.array([0.0, 0.0, height])
    mesh, corners = (TetMesh(m.vertices + up, m.tets) for m in (mesh, corners))
    gravity = 9.81 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    body = ElasticBody(mesh, youngs_modulus=TRUE, poisson_ratio=0.35, density=1000.0)
    scene = Scene(body, obstacles=(Plane(friction=0.3),), gravity=tuple(gravity))
    run = simulate(scene, Timing(frames=FRAMES, fps=FPS, steps_per_frame=8))
    noise = 1e-4 * np.random.default_rng(0).normal(size=run.positions.shape)
    capture = Capture(
        folder, FPS, FRAMES, 16, density=1000.0,
        floor=Floor(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=0.3),
        initial_velocity=np.zeros(3), initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    tracks = Tracks(mesh.vertices, run.positions + noise, np.full(run.positions.shape[:2], 1e-4))
    save_capture(capture, tets=corners, tracks=tracks)
    return capture


@cache
def fitted(folder):
    return rough_baseline(load_capture(folder), OPTIONS, lambda text: None)


def searched(capture, change, *, told=False):
    """The search after the flight was looked at, from a base model whose E is so many decades off.

    With `told`, a fit is there already that says what was seen.
    """
    base = fitted(capture.folder)
    values = base.fit.values.copy()
    values[base.model.base.index(MODULUS)] = np.log10(TRUE) + change
    motion = base.model.motion(values)
    count = int(base.split.fitted[-1]) + 1
    tangents = replace(base.model, frames=count).linearise(values, motion.first(count))[1]
    fit = replace(base.fit, parameters=base.model.parameters(values), values=values)
    base = replace(base, fit=fit, motion=motion, tangents=tangents)
    rows = len(base.residual(base.positions))
    search = EffectSearch(
        base, as_reduced(base), ErrorModel(np.ones(rows), np.zeros((0, rows))), OPTIONS, lambda _: None
    )
    search.found.append(base_hypothesis(search.base, search.errors))
    if told:
        seen = capture.tracks().positions
        search.found.append(replace(search.found[0], positions=seen, likelihood=search.found[0].attainable))
    from_flight(search, Numerics(*[np.zeros_like(motion.positions)] * 5), EFFECTS)
    return search


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    return dropped(tmp_path_factory.mktemp("tilted") / "capture", TILT, 0.12)


@pytest.fixture(scope="module")
def far_off(tilted):
    return searched(tilted, 1.2)


@pytest.mark.slow
def test_the_flight_tells_the_tilt_and_the_contact_the_modulus(far_off):
    search = far_off
    best = min(search.found, key=lambda h: h.fitted)
    assert best.fitted < 0.05 * search.found[0].fitted
    assert "gravity_tilt" in best.names
    assert best.values[0] == pytest.approx(np.log10(TRUE), abs=0.1)  # 1.2 decades off before
    effect = best.effects[best.names.index("gravity_tilt")]
    assert np.linalg.norm(best.doses(effect)[0]) == pytest.approx(np.degrees(TILT), abs=0.3)


@pytest.mark.slow
def test_what_follows_an_impact_draws_no_dose_away_from_what_the_flight_says(tmp_path, tilted):
    """The body is thrown aside as it strikes, by .8 m/s, which a tilt that is half as large again would follow."""
    tracks = tilted.tracks()
    struck = np.maximum(np.arange(FRAMES) - 10, 0) / FPS
    aside = tracks.positions - struck[:, None, None] * np.array([0.8, 0.0, 0.0])
    thrown = replace(tilted, folder=tmp_path / "thrown")
    save_capture(thrown, tets=tilted.tets(), tracks=replace(tracks, positions=aside))
    search = searched(thrown, 0.6)
    told = next(h for h in search.found if h.names == ("gravity_tilt",))
    assert np.linalg.norm(told.doses(told.effects[0])[0]) == pytest.approx(np.degrees(TILT), abs=0.1)


@pytest.mark.slow
def test_no_modulus_is_looked_for_where_nothing_shows_in_flight(tmp_path, tilted, monkeypatch):
    """A body that falls as the model says, or that strikes the floor at once."""
    assert len(searched(dropped(tmp_path / "upright", 0.0, 0.12), 0.6).found) == 1
    assert len(searched(dropped(tmp_path / "low", TILT, 0.01), 0.6).found) == 1
    monkeypatch.setattr(starting_points, "SEARCH", replace(SEARCH, flight_open=np.inf))
    assert len(searched(tilted, 0.6).found) == 1


@pytest.mark.slow
def test_nothing_is_looked_for_where_a_fit_says_what_the_flight_shows(tilted):
    """Else it takes from the search what a further effect needs that shows later."""
    assert len(searched(tilted, 0.6, told=True).found) == 2
    assert len(searched(tilted, 0.6).found) > 1


@pytest.mark.slow
def test_numerical_error_is_told_anew_where_a_fit_led_far_from_the_base_fit(far_off):
    """With the wrong E the finer mesh parts from the base model by something else than with the one that is found."""
    search = copy.copy(far_off)
    before, far = search.ranked, search.full
    best = search.best
    assert best.effects and abs(best.values[0] - far.fit.values[0]) > 0.5
    search.full = replace(far, fit=replace(far.fit, values=best.values[: len(far.fit.values)]))
    assert expect_anew(search) is None  # the base fit is there
    search.full, search.found = far, [h for h in before if not h.effects]
    assert expect_anew(search) is None  # no effect led anywhere
    search.found = before
    numerics = expect_anew(search)
    assert numerics is not None
    there = replace(far.model, effects=best.effects)
    halved = replace(there, refinement=2).motion(best.values).positions
    np.testing.assert_allclose(numerics.steps, halved - there.motion(best.values).positions, atol=1e-9)
    assert (search.errors.expected > 1).any()  # nothing but noise was expected before
    assert {id(h.motion) for h in search.found} == {id(h.motion) for h in before}
    assert all(h.fitted < b.fitted for h in search.found for b in before if h.motion is b.motion)
