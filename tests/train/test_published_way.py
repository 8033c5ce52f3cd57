"""The published way and its variants on a film of a painted box that their own model makes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from physconvex import InputError
from physconvex.dynamics import simulate
from physconvex.identify import PhotometricObservations
from physconvex.io import Capture, Floor, load_capture, look_at, save_capture
from physconvex.reduced import untrained_neural_weights
from physconvex.render import View, render
from tests.painted_box import box_surface, painted_wedges
from train.paper.published_way import NAMES, WAYS, PublishedOptions, _convex_twin, fit_as_published

LOW, HIGH = np.array([0.0, 0.0, 0.02]), np.array([0.3, 0.2, 0.12])
TRUE = np.array([4.0, 0.38])
START = TRUE + np.array([0.15, -0.03])
SMALL = PublishedOptions(weights=2, steps=4, max_nodes=80)


@pytest.fixture(scope="module", autouse=True)
def quick_weights():
    """Random weights, which need no training."""

    def untrained(samples, count, **_):
        return untrained_neural_weights(samples, count, generator=torch.Generator().manual_seed(0))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("physconvex.identify.convexes.train_neural_weights", untrained)
        yield


@pytest.fixture(scope="module")
def field():
    return painted_wedges(LOW, HIGH).to(torch.float32)


@pytest.fixture(scope="module")
def capture(tmp_path_factory, field):
    """Six frames of a dropped box and two of its future, by implicit Euler with one step a frame."""
    folder = tmp_path_factory.mktemp("published")
    camera = look_at((0.5, -0.8, 0.5), (0.15, 0.1, 0.07), width=64, height=52, vertical_field_of_view=0.5)
    stated = {"floor": Floor(np.zeros(3), np.array([0.0, 0.1, 1.0]), friction=0.3)}
    stated |= {"initial_velocity": np.array([0.0, 0.0, -1.0]), "initial_angular_velocity": np.zeros(3)}
    surface = box_surface(LOW, HIGH)
    bare = Capture(folder / "bare", 24.0, 8, 6, **stated)
    save_capture(bare, mesh=surface)
    twin = _convex_twin(load_capture(bare.folder), field, TRUE, SMALL)
    timing = replace(twin.timing(), integrator="implicit_euler", steps_per_frame=1)
    moved = simulate(twin.scene, timing).positions(field.points.double().numpy().reshape(-1, 3))
    assert moved[0, :, 2].min() > 0.005 and moved[5, :, 2].min() < 0.005
    grey = np.full((52, 64, 3), 0.4, dtype=np.float32)
    empty = PhotometricObservations(camera, field, np.zeros((8, 52, 64, 3)), grey, np.tile([0, 52, 0, 64], (8, 1)))
    position = View.of(camera, torch.float32).position
    images = []
    for points in moved:
        shown = empty.field_at(torch.as_tensor(points).float().reshape(field.points.shape), position)
        images.append(render(shown, camera, background=torch.as_tensor(grey)))
    frames = np.stack([(255 * image.colour.clamp(0, 1)).round().to(torch.uint8).numpy() for image in images])
    masks = np.stack([image.alpha.numpy() > 0.01 for image in images])
    filmed = Capture(folder / "filmed", 24.0, 8, 6, (camera,), **stated)
    name = camera.name
    save_capture(filmed, masks={name: masks}, mesh=surface)
    (filmed.folder / name).mkdir()
    for number, frame in enumerate(frames):  # videos would lose the colours of small images
        Image.fromarray(frame).save(filmed.folder / name / f"{number:03d}.png")
    return load_capture(filmed.folder)


def test_adam_goes_down_and_continues_where_it_was_stopped(capture, field, tmp_path):
    steps = []
    whole = fit_as_published(capture, field, START, options=SMALL, on_step=lambda *done: steps.append(done))
    assert [step for step, _ in steps] == [1, 2, 3, 4] and whole.losses.tolist() == [loss for _, loss in steps]
    assert whole.losses[-1] < whole.losses[0]
    # Adam's first steps are as long as its rates
    np.testing.assert_allclose(np.abs(whole.values - START) <= 4.1 * np.array([5e-3, 1e-3]), True)
    assert abs(whole.values[0] - TRUE[0]) < 0.14
    first = replace(SMALL, steps=2)
    fit_as_published(capture, field, START, options=first, out=tmp_path)
    steps.clear()
    again = fit_as_published(
        capture, field, START, options=SMALL, out=tmp_path, on_step=lambda *done: steps.append(done)
    )
    assert [step for step, _ in steps] == [3, 4]
    np.testing.assert_allclose(again.losses, whole.losses, rtol=1e-6)
    np.testing.assert_allclose(again.values, whole.values, rtol=1e-9)
    with pytest.raises(InputError, match="holds another fit"):
        fit_as_published(capture, field, START + 0.01, options=SMALL, out=tmp_path)


def test_the_moved_convexes_are_those_of_the_motion(capture, field):
    found = fit_as_published(capture, field, START, options=replace(SMALL, steps=1))
    moved = found.fields(range(6, 8))
    expected = found.trajectory.positions(field.points.double().numpy().reshape(-1, 3))[6:]
    assert len(moved) == 2 and len(found.trajectory.coordinates) == 8
    np.testing.assert_allclose(moved[1].points.reshape(-1, 3).numpy(), expected[1], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("way", list(WAYS))
def test_each_way_comes_nearer(capture, field, way):
    """Levenberg–Marquardt recovers what its own integrator made; Adam's few steps go towards it."""
    options = replace(PublishedOptions.of_way(way), weights=2, steps=3, max_nodes=80, turns=0)
    found = fit_as_published(capture, field, START, options=options)
    body = found.twin.scene.body
    assert found.values == pytest.approx([np.log10(body.youngs_modulus[0]), body.poisson_ratio[0]])
    assert found.losses[-1] < found.losses[0]
    if way == "published_own_optimiser":
        assert np.abs(found.values - TRUE).max() < 0.05  # 8 bits, and the background's estimate


def test_a_capture_without_video_is_named(capture, field):
    bare = load_capture(capture.folder.parent / "bare")
    with pytest.raises(InputError, match="no camera has a video"):
        fit_as_published(bare, field, START, options=SMALL)
    assert NAMES == ("log10_youngs_modulus", "poisson_ratio")
