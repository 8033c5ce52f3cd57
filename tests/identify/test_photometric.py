"""Rendered convexes as observations: derivatives end to end, and the fit of a material to pixels alone."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from physconvex.identify import PhotometricObservations, Twin

NAMES = ("log10_youngs_modulus", "poisson_ratio", "initial_velocity_x", "initial_angular_velocity_y")
TRUE = np.array([np.log10(2e4), 0.38, 0.2, 0.3])
FRAMES = 6


def test_the_true_material_leaves_nothing_and_another_does(
    painted_twin: Twin, box_film: PhotometricObservations
) -> None:
    from physconvex.identify import ReducedModel

    model = ReducedModel(painted_twin, NAMES, box_film.points, FRAMES)
    assert np.abs(box_film.residuals(model.positions(TRUE))).max() < 1e-9
    other = box_film.residuals(model.positions(TRUE + np.array([0.2, 0, 0, 0])))
    assert len(other) == len(box_film.frames) == 3 * 22 * 24 * FRAMES and np.abs(other).max() > 0.5
    assert np.abs(other[box_film.frames == 0]).max() < 1e-9  # frame 0 is the state at t = 0
    assert box_film.point_indices.max() < len(box_film.points)


@pytest.mark.parametrize("change", [{}, {"exposure": False}, {"blur": 1.2}])
def test_image_derivatives_against_differences_through_contact(
    painted_twin: Twin, box_film: PhotometricObservations, change: dict[str, float]
) -> None:
    from physconvex.identify import ReducedModel

    box_film = replace(box_film, **change)  # type: ignore[arg-type]
    timing = replace(painted_twin.timing(), tolerance=1e-11)
    model = ReducedModel(painted_twin, NAMES, box_film.points, FRAMES, timing=timing)
    at = TRUE + np.array([0.1, -0.03, 0.05, 0.2])
    lowest = model.positions(at)[..., 2].min(axis=1)
    assert lowest[0] > 0 and lowest[-1] < 0.002  # it has landed
    residuals, jacobian = box_film.linearise(*model.linearise(at))
    assert np.allclose(residuals, box_film.residuals(model.positions(at)))
    for place, step in enumerate((1e-5, 1e-5, 1e-5, 1e-5)):
        ends = [box_film.residuals(model.positions(at + sign * step * np.eye(4)[place])) for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        error = np.linalg.norm(jacobian[:, place] - expected) / np.linalg.norm(expected)
        assert error < 1e-3, NAMES[place]


def test_coarser_images_are_averages_of_the_fine_ones(painted_twin: Twin, box_film: PhotometricObservations) -> None:
    from physconvex.identify import PhotometricObservations, ReducedModel

    frames = (255 * box_film.images).round().astype(np.uint8)
    masks = np.abs(box_film.images - 0.4).max(-1) > 0.02
    coarse = PhotometricObservations.of_video(box_film.camera, frames, masks, box_film.field, scale=0.5)
    moved = ReducedModel(painted_twin, NAMES, box_film.points, FRAMES).positions(TRUE)
    assert coarse.images.shape == (FRAMES, 12, 14, 3) and coarse.fine == 2
    assert np.abs(coarse.residuals(moved)).max() * coarse.sigma < 0.02  # 8 bits, and the background's estimate


def test_pixels_alone_tell_the_material(painted_twin: Twin, box_film: PhotometricObservations) -> None:
    from physconvex.identify import ReducedModel, default_parameter, fit

    model = ReducedModel(painted_twin, NAMES, box_film.points, FRAMES)
    starts = TRUE + np.array([0.3, -0.1, 0.05, 0.2])
    found = fit(model, box_film, [default_parameter(n, start=float(v)) for n, v in zip(NAMES, starts, strict=True)])
    assert found.converged and np.abs(found.values - TRUE).max() < 1e-3


def test_camera_pose_as_a_nuisance_has_the_derivatives_of_a_moved_camera(
    painted_twin: Twin, box_film: PhotometricObservations
) -> None:
    from physconvex.identify import ReducedModel
    from physconvex.identify.nuisance import _camera_columns

    positions = ReducedModel(painted_twin, NAMES, box_film.points, FRAMES).positions(TRUE + np.array([0.1, 0, 0, 0]))
    columns = _camera_columns(box_film, positions, box_film.camera)
    for axis in range(3):
        ends = []
        for sign in (1, -1):
            matrix = np.array(box_film.camera.transform_matrix)
            matrix[:3, 3] += sign * 1e-6 * box_film.camera.rotation[:, axis]
            ends.append(
                replace(box_film, camera=replace(box_film.camera, transform_matrix=matrix)).residuals(positions)
            )
        expected = (ends[0] - ends[1]) / 2e-6
        assert np.linalg.norm(columns[:, 3 + axis] - expected) < 1e-3 * np.linalg.norm(expected)


def test_followed_points_lead_pixels_to_a_far_drift(painted_twin: Twin, box_film: PhotometricObservations) -> None:
    """A drift of several pixels lies beyond what colours see; a few followed points find it."""
    from physconvex.identify import PixelObservations, ReducedModel, RigidDriftObservations, StackedObservations

    some = painted_twin.mesh.vertices[:: max(1, len(painted_twin.mesh.vertices) // 8)]
    begin, interval, far = 2, 1 / painted_twin.fps, np.zeros((FRAMES, 1, 3))
    far[begin:, 0, 0] = -0.03 * np.arange(1, FRAMES - begin + 1)
    model = ReducedModel(painted_twin, NAMES, np.concatenate([some, box_film.points]), FRAMES)
    positions = model.positions(TRUE) + far
    pixels, _ = box_film.camera.project(positions[:, : len(some)] - far)
    points = PixelObservations(box_film.camera, some, pixels, np.full(pixels.shape[:2], 0.3))
    stack = StackedObservations.of([points, box_film])
    both = RigidDriftObservations(stack, begin, interval, 3.0)
    alone = RigidDriftObservations(StackedObservations.of([box_film]), begin, interval, 3.0)
    reached = both.drift(positions)[-1, len(some) :] + far[-1]
    missed = alone.drift(positions[:, len(some) :])[-1] + far[-1]
    assert np.linalg.norm(reached, axis=-1).mean() < 0.003
    assert np.linalg.norm(missed, axis=-1).mean() > 0.03


def test_wrong_inputs_are_told(box_film: PhotometricObservations) -> None:
    from physconvex import InputError

    with pytest.raises(InputError, match=r"images, background: got \(6, 20, 28, 3\)"):
        replace(box_film, images=box_film.images[:, :20])
    with pytest.raises(InputError, match="windows"):
        replace(box_film, windows=np.zeros((FRAMES, 4), dtype=int))
