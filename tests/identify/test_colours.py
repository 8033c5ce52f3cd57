"""Colours carried by a model: a painted box that moves, seen by one camera; nuisances of the camera and the clock."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from physconvex import InputError
from physconvex.identify import (
    ColourObservations,
    MarginalObservations,
    Nuisance,
    PixelObservations,
    StackedObservations,
    blurred,
    cast_camera_rays,
    colour_seeds,
    default_parameter,
    fit,
    seen_by,
)
from physconvex.io import Camera, look_at
from physconvex.mesh import box_mesh

SHIFT = np.array([0.012, 0.0, -0.009])
FRAMES = 3


class Shifted:
    """A body that moves by p per frame along x and z."""

    names = ("initial_velocity_x", "initial_velocity_z")

    def __init__(self, points):
        self.points = points
        self.steps = np.arange(FRAMES)[:, None, None] * np.ones((1, len(points), 1))

    def positions(self, values):
        return self.points + self.steps * np.array([values[0], 0.0, values[1]])

    def linearise(self, values):
        tangents = np.zeros((FRAMES, 2, len(self.points), 3))
        tangents[:, 0, :, 0] = tangents[:, 1, :, 2] = self.steps[..., 0]
        return self.positions(values), tangents


@pytest.fixture(scope="module")
def scene():
    """Camera, surface, and pictures of a box that moves by SHIFT per frame."""
    camera = look_at([0.1, -1.0, 0.3], [0.1, 0.1, 0.1], width=120, height=100, vertical_field_of_view=0.45, name="a")
    mesh = box_mesh((0.25, 0.2, 0.2), (2, 2, 2), order=1)
    triangles = mesh.boundary_faces[:, :3]
    images = []
    for frame in range(FRAMES):
        hits = cast_camera_rays(camera, mesh.vertices + frame * SHIFT, triangles)
        rest = np.nan_to_num(hits.on(mesh.vertices, triangles))
        waves = np.stack([np.sin(rest @ k) for k in ([90, 20, 40], [-30, 60, 80], [50, -70, 60])], axis=-1)
        inside = (hits.faces >= 0)[..., None]
        images.append(np.where(inside, 127 + 100 * waves, 30).astype(np.uint8))
    return camera, mesh.vertices, triangles, np.stack(images)


def observed(scene, images=None, **options):
    camera, vertices, triangles, own = scene
    images = own if images is None else images
    seeds = colour_seeds(camera, images[0], vertices, triangles, count=150)
    points, steps = seeds.on(vertices, triangles), np.arange(FRAMES)[:, None, None] * SHIFT
    visible = seen_by(camera, vertices + steps, triangles, points + steps, seeds.faces)
    return ColourObservations(camera, points, blurred(images, 1.2), visible, **options)


def unknowns(*values):
    return [default_parameter(name, start=value) for name, value in zip(Shifted.names, values, strict=True)]


def test_the_motion_is_found_from_the_colours(scene):
    seen = observed(scene)
    found = fit(Shifted(seen.points), seen, unknowns(0.009, -0.006))
    np.testing.assert_allclose(found.values, SHIFT[[0, 2]], atol=4e-4)  # a pixel is 5 mm
    assert 50 < len(seen.points) <= 150 and seen.in_frames(2).frames.max() == 1


def test_derivatives_against_differences(scene):
    seen = observed(scene)
    model, values = Shifted(seen.points), np.array([0.011, -0.008])
    _, jacobian = seen.linearise(*model.linearise(values))
    for k in range(2):
        step = 2e-3 * np.eye(2)[k]
        slope = (seen.residuals(model.positions(values + step)) - seen.residuals(model.positions(values - step))) / 4e-3
        assert np.corrcoef(slope, jacobian[:, k])[0, 1] > 0.97
        assert jacobian[:, k] @ slope / (slope @ slope) == pytest.approx(1.0, abs=0.08)


def test_another_exposure_does_no_harm_where_it_is_free(scene):
    darker = scene[3].astype(float)
    darker[1:] = 0.7 * darker[1:] + 25
    left, values = [], []
    for exposure in (True, False):
        seen = observed(scene, darker.astype(np.uint8), exposure=exposure)
        found = fit(Shifted(seen.points), seen, unknowns(0.009, -0.006))
        values.append(found.values)
        left.append(np.sqrt(np.mean(found.residuals**2)))
    np.testing.assert_allclose(values[0], SHIFT[[0, 2]], atol=5e-4)
    assert left[0] < 0.3 * left[1]


def seen_while_turning(scene, points, angles, **options):
    """Which points on the box are seen after turns about the upright through its middle."""
    camera, vertices, triangles, _ = scene
    middle = np.array([0.125, 0.1, 0.0])
    turns = Rotation.from_rotvec(np.outer(angles, [0.0, 0.0, 1.0]))
    moved = np.stack([turn.apply(vertices - middle) + middle for turn in turns])
    carried = np.stack([turn.apply(points - middle) + middle for turn in turns])
    surface = trimesh.Trimesh(vertices, triangles, process=False)
    faces = trimesh.proximity.closest_point_naive(surface, points)[2]
    return seen_by(camera, moved, triangles, carried, faces, **options)


def test_hidden_points_are_left_out(scene):
    points = np.array([[0.12, 0.0, 0.1], [0.12, 0.2, 0.1]])  # on the front, on the back
    np.testing.assert_array_equal(seen_while_turning(scene, points, [0.0]), [[True, False]])


@pytest.mark.parametrize("side", [0.004, 0.246])
def test_a_point_beside_an_edge_is_left_out_once_its_side_turns_away(scene, side):
    """The side beside it, which is seen then in its place, is as near as the point itself."""
    points = np.array([[side, 0.0, 0.1], [0.125, 0.0, 0.1]])
    turn = np.radians(100.0) * (1 if side < 0.1 else -1)
    seen = seen_while_turning(scene, points, [0.0, 0.1 * turn, turn], margin=0.1)
    np.testing.assert_array_equal(seen, [[True, True], [True, True], [False, False]])


def test_a_point_whose_side_is_hardly_seen_at_first_is_never_compared(scene):
    points = np.array([[0.0, 0.1, 0.1]])  # on the left side
    assert seen_while_turning(scene, points, np.radians([20.0, 60.0]))[:, 0].tolist() == [False, False]
    assert seen_while_turning(scene, points, np.radians([60.0, 20.0, 60.0]))[:, 0].tolist() == [True, False, True]


def test_points_beside_the_outline_are_left_out_as_the_blur_mixes_the_background_in(scene):
    points = np.array([[0.125, 0.0, 0.01], [0.125, 0.0, 0.1]])  # a pixel is 5 mm
    assert seen_while_turning(scene, points, [0.0], margin=1.0).tolist() == [[True, True]]
    assert seen_while_turning(scene, points, [0.0], margin=4.0).tolist() == [[False, True]]


def pixels_seen_by(true_camera: Camera, camera: Camera, offset: float = 0.0):
    """Points that moved evenly, but were filmed by another camera and a late clock than is believed."""
    points = np.random.default_rng(1).uniform(size=(40, 3)) * 0.2
    moved = points + (np.arange(FRAMES)[:, None, None] + offset) * SHIFT
    moved[0] = points
    pixels = np.stack([true_camera.project(x)[0] for x in moved])
    return PixelObservations(camera, points, pixels, np.full((FRAMES, 40), 0.05), robust_scale=np.inf)


def test_a_late_clock_is_found_and_does_not_bias():
    camera = look_at([0.1, -1.0, 0.3], [0.1, 0.1, 0.1], width=120, height=100, vertical_field_of_view=0.45, name="a")
    plain = StackedObservations((pixels_seen_by(camera, camera, offset=0.2),))
    free = MarginalObservations(plain, Nuisance(time_offset=1.0), 1.0)
    model, start = Shifted(plain.points), unknowns(0.01, -0.01)
    biased, found = fit(model, plain, start), fit(model, free, start)
    assert np.abs(biased.values - SHIFT[[0, 2]]).max() > 8e-4
    np.testing.assert_allclose(found.values, SHIFT[[0, 2]], atol=2e-4)
    assert free.estimates(found.positions)["time_offset [s]"] == pytest.approx(0.2, abs=0.03)


def test_a_turned_camera_is_found():
    camera = look_at([0.1, -1.0, 0.3], [0.1, 0.1, 0.1], width=120, height=100, vertical_field_of_view=0.45, name="a")
    seen = pixels_seen_by(camera, camera)
    turned = np.stack([seen.pixels[t] + (t > 0) * np.array([1.5, 0.0]) for t in range(FRAMES)])
    # 1.5 pixels to the right from the second frame on: what a camera that turned by 1.5/f would see
    bumped = StackedObservations((PixelObservations(camera, seen.points, turned, seen.sigma, np.inf),))
    assert Nuisance().any is False and Nuisance(camera_rotation=0.01).any
    free = MarginalObservations(bumped, Nuisance(time_offset=1.0, camera_position=0.05), 1.0)
    names = free.names
    assert names[0] == "time_offset [s]" and names[1] == "a/position_x [m]" and len(names) == 4
    residuals, jacobian = free.linearise(*Shifted(bumped.points).linearise(SHIFT[[0, 2]]))
    assert np.linalg.norm(residuals) < np.linalg.norm(bumped.residuals(Shifted(bumped.points).positions(SHIFT[[0, 2]])))
    assert jacobian.shape == (len(residuals), 2)


def test_a_negative_deviation_is_named():
    with pytest.raises(InputError, match="time_offset"):
        Nuisance(time_offset=-1.0)
