"""A box whose rebound is another one than the model's: what `refine` makes of it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inference import RefineOptions, refine
from inference.refinement.convex_start import least_drift
from inference.refinement.rigid_drift import _continued
from physconvex.fem import SurfacePoints
from physconvex.identify import FullModel, TwinOptions, base_twin
from physconvex.io import Capture, Floor, Tracks, load_capture, save_capture
from physconvex.mesh import TetMesh, box_mesh

FRAMES, AHEAD, NOISE, FPS = 8, 3, 2e-4, 48.0
NAMES, TRUTH = ("log10_youngs_modulus", "poisson_ratio"), np.array([4.3, 0.35])
OPTIONS = RefineOptions(
    weights=3, steps_per_frame=4, model_error=False, field=False,
    initial={"log10_youngs_modulus": 4.2, "poisson_ratio": 0.3}, fixed={"damping_time": 0.0},
)  # fmt: skip


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """Tracks of a box on a rough floor by the full model, as they are and flung aside after the contact."""
    root = tmp_path_factory.mktemp("drift")
    box = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1)
    tets = TetMesh(box.vertices + np.array([0, 0, 0.012]), box.tets)
    rng = np.random.default_rng(0)
    points = rng.uniform(size=(12, 3)) * [0.3, 0.2, 0.1] + [0, 0, 0.012]
    floor = Floor(np.zeros(3), np.array([0.1, 0.05, 1.0]), friction=0.4)

    def save(name, positions):
        still = {"initial_velocity": np.array([0.0, 0.0, -0.6]), "initial_angular_velocity": np.zeros(3)}
        capture = Capture(root / name, FPS, len(positions), FRAMES, floor=floor, **still)
        save_capture(capture, tets=tets, tracks=Tracks(points, positions, np.full(positions.shape[:2], NOISE)))
        return load_capture(root / name)

    frames = FRAMES + AHEAD
    twin = base_twin(save("plain", np.zeros((frames, 12, 3))), TwinOptions(weights=3, steps_per_frame=4))
    surface = SurfacePoints.of_triangles(*tets.surface)
    moved = FullModel(twin, NAMES, points, frames, surface=surface).positions(TRUTH)
    since = np.clip(np.arange(frames) / FPS - 1.5 / FPS, 0, None)[:, None, None]
    arms = moved - moved.mean(axis=1, keepdims=True)
    flung = moved + since * (np.array([0.15, -0.1, 0.1]) + np.cross([0.4, 0.6, -0.3], arms))
    noise = rng.normal(scale=NOISE, size=moved.shape)
    return save("seen", moved + noise).folder, save("flung", flung + noise).folder


@pytest.mark.slow
def test_the_material_is_found_although_the_rebound_is_another_one(captures):
    found, plain = (refine(captures[1], options=OPTIONS.replace(drift=drift)) for drift in (True, False))
    for name, truth in zip(NAMES, TRUTH, strict=True):
        low, high = found[name].interval
        assert low < truth < high
    assert abs(found[NAMES[0]].value - TRUTH[0]) < 0.5 * abs(plain[NAMES[0]].value - TRUTH[0])
    assert found.reduced_chi_square < 2 < plain.reduced_chi_square
    assert plain.drift is None and plain.to_json()["rigid_drift"] is None
    told = json.loads(json.dumps(found.to_json()))["rigid_drift"]
    assert told["first_frame"] in (1, 2) and max(told["rms_m"]) == pytest.approx(0.02, rel=0.4)
    assert any("drifts from the model as a rigid body" in sentence for sentence in found.warnings)
    ahead = load_capture(captures[1]).tracks().positions[FRAMES:]
    followed, alone = (np.linalg.norm(m.markers[FRAMES:] - ahead, axis=-1) for m in (found.followed, found.motion))
    assert followed.max() < 0.25 * alone.min()


def test_a_model_goes_on_from_where_the_body_is_seen(tmp_path):
    """A box, turned about the vertical and set aside, lands on the flat floor as it would have, there."""
    box, begin, more = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1), 4, 5
    tets = TetMesh(box.vertices + np.array([0, 0, 0.02]), box.tets)
    still = {"initial_velocity": np.zeros(3), "initial_angular_velocity": np.array([1.0, 0.5, 0.0])}
    floor = Floor(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=0.3)
    save_capture(Capture(tmp_path / "box", FPS, begin, begin, floor=floor, **still), tets=tets)
    twin = base_twin(load_capture(tmp_path / "box"), TwinOptions(weights=3, steps_per_frame=16))
    model = FullModel(twin, NAMES, twin.mesh.vertices, begin)
    whole = replace(model, frames=begin + more).positions(TRUTH)
    turn = Rotation.from_rotvec([0, 0, 0.7])
    aside = np.array([0.2, -0.1, 0.0])
    placed = np.array([turn.apply(x) + aside for x in whole])
    drift = np.broadcast_to([0.3, 0.0, 0.0], twin.mesh.vertices.shape)
    seen, pushed = (_continued(model, TRUTH, placed[begin - 1], by, 1 + more) for by in (0 * drift, drift))
    moved = np.linalg.norm(placed[-1] - placed[begin - 1], axis=-1).max()
    assert np.linalg.norm(seen - placed[begin - 1 :], axis=-1).max() < 0.05 * moved
    sunk = _continued(model, TRUTH, placed[begin - 1] - [0, 0, 0.06], 0 * drift, 1 + more)
    np.testing.assert_allclose(sunk, seen, atol=1e-3 * moved)
    assert 0.5 * 0.3 / FPS < (pushed - seen)[1, :, 0].mean() < 0.3 / FPS  # friction brakes it


@pytest.mark.slow
def test_where_the_model_follows_there_is_none(captures):
    found = refine(captures[0], options=OPTIONS)
    assert found.drift is None
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH[0], abs=0.01)


def test_the_smallest_drift_is_taken_that_explains_about_as_much():
    """Two candidates, without drift and with two sizes: much drift hides which of them is right."""
    assert least_drift([[-900.0, -150.0, -100.0], [-700.0, -120.0, -105.0]]) == (1, 1)
    assert least_drift([[-900.0, -150.0, -60.0], [-700.0, -120.0, -65.0]]) == (0, 2)  # only much drift explains it
    assert least_drift([[-np.inf], [-9.0, -8.0, -7.0]]) == (1, 0)  # one cannot be simulated; the other needs no drift
