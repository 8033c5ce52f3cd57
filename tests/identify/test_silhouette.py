"""A silhouette filled from its border is what all triangles, drawn one by one, cover."""

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from physconvex.identify.silhouette import Borders, filled_border
from physconvex.io import look_at

CAMERA = look_at((0, -3, 0.4), (0, 0, 0), width=96, height=80, vertical_field_of_view=0.9)


def drawn(vertices, triangles, camera=CAMERA):
    """Every triangle that faces the camera, one by one; and by the border of them all."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = ((camera.position - corners[:, 0]) * normals).sum(1) > 0
    pixels, _ = camera.project(vertices)
    canvas = np.zeros((camera.h, camera.w), np.uint8)
    for triangle in np.round((pixels[triangles[facing]] - 0.5) * 16).astype(np.int32):
        cv2.fillConvexPoly(canvas, triangle, 1, shift=4)
    border = Borders(triangles).of(facing)
    return canvas, filled_border(pixels[border[:, 0]], pixels[border[:, 1]], camera.h, camera.w)


def torus():
    return trimesh.creation.torus(0.8, 0.3, major_sections=40, minor_sections=20)


def in_two_parts():
    """One ball before another, larger one."""
    balls = [trimesh.creation.icosphere(3, radius).apply_translation((0, y, 0)) for radius, y in ((0.3, -1), (0.8, 1))]
    return trimesh.util.concatenate(balls)


def open_bowl():
    ball = trimesh.creation.icosphere(3, 0.9)
    return trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0.3], process=False)


def with_an_edge_of_four():
    """Two boxes that share an edge."""
    one, other = (trimesh.creation.box((0.5, 0.5, 0.5)).apply_translation((s, 0, s)) for s in (-0.25, 0.25))
    both = trimesh.util.concatenate([one, other])
    both.merge_vertices()
    return both


@pytest.mark.parametrize("shape", [torus, in_two_parts, open_bowl, with_an_edge_of_four])
def test_the_border_alone_fills_what_all_triangles_cover(shape):
    mesh = shape()
    for seed in range(4):
        turned = np.asarray(mesh.vertices) @ Rotation.random(random_state=seed).as_matrix().T
        one_by_one, filled = drawn(turned, np.asarray(mesh.faces))
        assert one_by_one.sum() > 300
        inner, outer = (
            change(one_by_one, np.ones((3, 3), np.uint8)) for change in (cv2.erode, cv2.dilate)
        )  # the two round alike but for the last pixel
        assert (inner <= filled).all() and (filled <= outer).all()
        assert (one_by_one != filled).mean() < 0.01


def test_what_reaches_beyond_the_image_is_cut_off():
    near = look_at((0, -1.2, 0.1), (0.5, 0, 0), width=96, height=80, vertical_field_of_view=0.9)
    ball = trimesh.creation.icosphere(3, 0.8)
    one_by_one, filled = drawn(np.asarray(ball.vertices), np.asarray(ball.faces), near)
    assert filled[:, 0].any() and filled[0].any() and not filled.all()
    assert (one_by_one != filled).mean() < 0.01


def test_a_border_runs_along_its_edges_as_the_triangles_do():
    square = np.array([[0, 1, 2], [0, 2, 3]])
    borders = Borders(square)
    assert {tuple(edge) for edge in borders.of(np.array([True, True]))} == {(0, 1), (1, 2), (2, 3), (3, 0)}
    assert {tuple(edge) for edge in borders.of(np.array([True, False]))} == {(0, 1), (1, 2), (2, 0)}
    assert len(borders.of(np.array([False, False]))) == 0


def test_nothing_is_filled_by_nothing():
    assert not filled_border(np.zeros((0, 2)), np.zeros((0, 2)), 8, 9).any()
