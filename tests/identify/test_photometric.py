"""Rendered convexes as observations: derivatives end to end, and the fit of a material to pixels alone."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
import trimesh

if TYPE_CHECKING:
    from physconvex.convex import ConvexField
    from physconvex.identify import PhotometricObservations, Twin

NAMES = ("log10_youngs_modulus", "poisson_ratio", "initial_velocity_x", "initial_angular_velocity_y")
TRUE = np.array([np.log10(2e4), 0.38, 0.2, 0.3])
FRAMES = 6


@pytest.fixture(scope="module")
def painted_box(box_twin: Twin) -> ConvexField:
    """The box as 12 wedges in random colours, whose harmonics depend on the direction."""
    from physconvex.convex import ConvexField, coefficients_of_colour

    low, high = box_twin.mesh.vertices.min(0), box_twin.mesh.vertices.max(0)
    rng, counts = np.random.default_rng(0), (3, 2, 1)
    wedges = []
    for cell in np.ndindex(counts):
        a, b = (low + (high - low) * (np.array(cell) + k) / counts for k in (0, 1))
        corners = np.array([[x, y, z] for z in (a[2], b[2]) for x, y in ((a[0], a[1]), (b[0], a[1]), (b[0], b[1]))])
        other = np.array([[x, y, z] for z in (a[2], b[2]) for x, y in ((a[0], a[1]), (b[0], b[1]), (a[0], b[1]))])
        wedges += [corners, other]
    points = torch.as_tensor(np.array(wedges))
    ones = torch.ones(len(points), dtype=torch.float64)
    colours = coefficients_of_colour(torch.as_tensor(rng.uniform(0.1, 0.9, (len(points), 3))))
    colours[:, 1:4] += torch.as_tensor(rng.normal(scale=0.05, size=(len(points), 3, 3)))
    return ConvexField(points, 200 * ones, ones, 0.98 * ones, colours)


@pytest.fixture(scope="module")
def twin(box_twin: Twin, painted_box: ConvexField) -> Twin:
    from physconvex.identify import convex_twin

    boxed = replace(box_twin, capture=replace(box_twin.capture, body=_surface(box_twin)))
    return convex_twin(boxed, painted_box, "eigenmodes", weights=3)


def _surface(twin: Twin) -> trimesh.Trimesh:
    vertices = twin.mesh.vertices
    box = trimesh.creation.box(np.ptp(vertices, axis=0))
    box.apply_translation(vertices.min(0) + np.ptp(vertices, axis=0) / 2)
    return box


@pytest.fixture(scope="module")
def seen(twin: Twin, painted_box: ConvexField) -> PhotometricObservations:
    """What a camera films of the box of the true material, on grey."""
    from physconvex.identify import PhotometricObservations, ReducedModel
    from physconvex.io import look_at
    from physconvex.render import View, render

    camera = look_at((0.5, -0.8, 0.5), (0.2, 0.1, 0.06), width=28, height=24, vertical_field_of_view=0.5)
    grey = np.full((24, 28, 3), 0.4)
    windows = np.tile([1, 23, 2, 26], (FRAMES, 1))
    empty = PhotometricObservations(camera, painted_box, np.zeros((FRAMES, 24, 28, 3)), grey, windows)
    moved = ReducedModel(twin, NAMES, empty.points, FRAMES).positions(TRUE)
    images = []
    for points in moved:
        field = empty.field_at(
            torch.as_tensor(points).reshape(painted_box.points.shape), View.of(camera, torch.float64).position
        )
        images.append(render(field, camera, background=torch.as_tensor(grey)).colour.numpy())
    return replace(empty, images=np.stack(images))


def test_the_true_material_leaves_nothing_and_another_does(twin: Twin, seen: PhotometricObservations) -> None:
    from physconvex.identify import ReducedModel

    model = ReducedModel(twin, NAMES, seen.points, FRAMES)
    assert np.abs(seen.residuals(model.positions(TRUE))).max() < 1e-9
    other = seen.residuals(model.positions(TRUE + np.array([0.2, 0, 0, 0])))
    assert len(other) == len(seen.frames) == 3 * 22 * 24 * FRAMES and np.abs(other).max() > 1.0
    assert np.abs(other[seen.frames == 0]).max() < 1e-9  # frame 0 is the state at t = 0
    assert seen.point_indices.max() < len(seen.points)


@pytest.mark.parametrize("change", [{}, {"exposure": False}, {"blur": 1.2}])
def test_image_derivatives_against_differences_through_contact(
    twin: Twin, seen: PhotometricObservations, change: dict[str, float]
) -> None:
    from physconvex.identify import ReducedModel

    seen = replace(seen, **change)  # type: ignore[arg-type]
    timing = replace(twin.timing(), tolerance=1e-11)
    model = ReducedModel(twin, NAMES, seen.points, FRAMES, timing=timing)
    at = TRUE + np.array([0.1, -0.03, 0.05, 0.2])
    lowest = model.positions(at)[..., 2].min(axis=1)
    assert lowest[0] > 0 and lowest[-1] < 0.002  # it has landed
    residuals, jacobian = seen.linearise(*model.linearise(at))
    assert np.allclose(residuals, seen.residuals(model.positions(at)))
    for place, step in enumerate((1e-5, 1e-5, 1e-5, 1e-5)):
        ends = [seen.residuals(model.positions(at + sign * step * np.eye(4)[place])) for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        error = np.linalg.norm(jacobian[:, place] - expected) / np.linalg.norm(expected)
        assert error < 1e-3, NAMES[place]


def test_coarser_images_are_averages_of_the_fine_ones(twin: Twin, seen: PhotometricObservations) -> None:
    from physconvex.identify import PhotometricObservations, ReducedModel

    frames = (255 * seen.images).round().astype(np.uint8)
    masks = np.abs(seen.images - 0.4).max(-1) > 0.02
    coarse = PhotometricObservations.of_video(seen.camera, frames, masks, seen.field, scale=0.5)
    moved = ReducedModel(twin, NAMES, seen.points, FRAMES).positions(TRUE)
    assert coarse.images.shape == (FRAMES, 12, 14, 3) and coarse.fine == 2
    assert np.abs(coarse.residuals(moved)).max() * coarse.sigma < 0.02  # 8 bits, and the background's estimate


def test_pixels_alone_tell_the_material(twin: Twin, seen: PhotometricObservations) -> None:
    from physconvex.identify import ReducedModel, default_parameter, fit

    model = ReducedModel(twin, NAMES, seen.points, FRAMES)
    starts = TRUE + np.array([0.3, -0.1, 0.05, 0.2])
    found = fit(model, seen, [default_parameter(n, start=float(v)) for n, v in zip(NAMES, starts, strict=True)])
    assert found.converged and np.abs(found.values - TRUE).max() < 1e-3


def test_camera_pose_as_a_nuisance_has_the_derivatives_of_a_moved_camera(
    twin: Twin, seen: PhotometricObservations
) -> None:
    from physconvex.identify import ReducedModel
    from physconvex.identify.nuisance import _camera_columns

    positions = ReducedModel(twin, NAMES, seen.points, FRAMES).positions(TRUE + np.array([0.1, 0, 0, 0]))
    columns = _camera_columns(seen, positions, seen.camera)
    for axis in range(3):
        ends = []
        for sign in (1, -1):
            matrix = np.array(seen.camera.transform_matrix)
            matrix[:3, 3] += sign * 1e-6 * seen.camera.rotation[:, axis]
            ends.append(replace(seen, camera=replace(seen.camera, transform_matrix=matrix)).residuals(positions))
        expected = (ends[0] - ends[1]) / 2e-6
        assert np.linalg.norm(columns[:, 3 + axis] - expected) < 1e-3 * np.linalg.norm(expected)


def test_wrong_inputs_are_told(seen: PhotometricObservations) -> None:
    from physconvex import InputError

    with pytest.raises(InputError, match=r"images, background: got \(6, 20, 28, 3\)"):
        replace(seen, images=seen.images[:, :20])
    with pytest.raises(InputError, match="windows"):
        replace(seen, windows=np.zeros((FRAMES, 4), dtype=int))
