"""The first convexes: triangles, prisms, fillers, hull, colours."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import ConvexHull

from physconvex import InputError
from physconvex.convex import ConvexField, coefficients_of_colour, inside_union
from physconvex.io import look_at
from physconvex.reconstruction import (
    ReconstructionConfig,
    begin,
    even_triangles,
    fit_field,
    load_reconstruction_config,
    score_views,
    start_field,
    visual_hull,
    welded,
)
from physconvex.reconstruction.first_convexes import fillers, octahedra, prisms, with_count
from physconvex.reconstruction.observation import gather
from physconvex.render import render
from tests.convex.hulls import hull_volumes
from tests.reconstruction.scenes import RADIUS, ball_mesh, striped_ball
from train import measure_coverage

BALL = 4 / 3 * math.pi * RADIUS**3


def as_field(points: np.ndarray) -> ConvexField:
    ones = torch.ones(len(points), dtype=torch.float64)
    colours = coefficients_of_colour(ones[:, None].expand(-1, 3))
    return ConvexField(torch.as_tensor(points), 1e4 * ones, ones, ones, colours)


@pytest.mark.parametrize("count", [300, 1280, 3000])
def test_triangles_are_as_many_as_wanted_and_cover_the_surface(count):
    mesh = ball_mesh()
    found = even_triangles(mesh, count)
    assert 0.9 * count <= len(found) <= count
    assert found.areas.sum() == pytest.approx(mesh.area, rel=0.03)
    outward = np.einsum("fkc,fkc->fk", found.corners, found.normals)
    assert (outward > 0.9 * RADIUS).all()
    assert found.areas.max() < 8 * np.median(found.areas)


def test_a_large_flat_face_is_divided_without_changing_the_shape():
    box = trimesh.creation.box((0.2, 0.1, 0.05))
    found = even_triangles(box, 500)
    assert len(found) == 500
    assert found.areas.sum() == pytest.approx(box.area, rel=1e-9)
    assert found.areas.max() <= 4.1 * found.areas.min()


def test_prisms_end_before_the_other_side_of_a_thin_plate():
    plate = trimesh.creation.box((0.1, 0.1, 0.002))
    points = prisms(even_triangles(plate, 200), plate, depth=0.01, overhang=0.0)
    faces = np.abs(points[:, :3, 2]).min(axis=1) > 0.0009
    inner = np.abs(points[faces][:, 3:, 2])
    assert faces.sum() > 100
    assert (np.sign(points[faces][:, 3:, 2]) == np.sign(points[faces][:, :3, 2])).mean() > 0.8
    assert inner.max() < 0.001


def test_fillers_fill_the_inside_and_stay_in_it():
    mesh = ball_mesh()
    field = as_field(fillers(mesh, depth=0.008, most=400))
    assert 10 < len(field) <= 400
    corners = field.points.reshape(-1, 3).numpy()
    assert np.linalg.norm(corners, axis=1).max() < RADIUS
    deep = np.random.default_rng(0).normal(size=(500, 3))
    deep *= 0.6 * RADIUS * np.random.default_rng(1).random((500, 1)) / np.linalg.norm(deep, axis=1, keepdims=True)
    assert inside_union(field, deep).all()
    assert 0.3 * BALL < hull_volumes(field).sum() < BALL
    assert len(fillers(mesh, depth=0.008, most=0)) == 0


def test_octahedra_touch_their_neighbours():
    points = np.stack(np.meshgrid(*[np.arange(3.0)] * 3), axis=-1).reshape(-1, 3)
    found = octahedra(points)
    np.testing.assert_allclose(np.linalg.norm(found - points[:, None], axis=2), 1.0)


def test_the_visual_hull_of_a_ball_holds_it_and_little_more(seen):
    hull = visual_hull(seen, cells=64)
    assert hull.is_watertight
    assert BALL < hull.volume < 1.25 * BALL
    assert np.linalg.norm(hull.vertices, axis=1).min() > 0.95 * RADIUS


def test_views_that_contradict_each_other_are_refused(seen):
    turned = look_at((0.4, 0, 0), (0.4, 1, 0), width=48, height=48, vertical_field_of_view=0.42, name="turned")
    wrong = [*seen, replace(seen[0], camera=turned)]
    with pytest.raises(InputError, match=r"behind it|no point in space"):
        visual_hull(wrong)
    with pytest.raises(InputError, match="parallel"):
        visual_hull([seen[0], seen[0]])


def test_pixels_are_shared_out_among_the_convexes_without_loss(seen):
    field = striped_ball()
    image = render(field, seen[0].view)
    found = gather(field, seen[0].view, seen[0].image)
    assert float(found.weights.sum()) == pytest.approx(float(image.alpha.sum()), rel=1e-5)
    expected = (image.alpha[..., None] * seen[0].image).sum(dim=(0, 1))
    torch.testing.assert_close(found.values.sum(dim=0), expected, rtol=1e-4, atol=1e-3)
    flat = gather(field, seen[0].view, torch.full_like(seen[0].image, 0.3)).means(torch.full((3,), 0.7))
    hidden = found.weights <= 1e-3
    assert hidden.any() and not hidden.all()
    torch.testing.assert_close(flat[~hidden], torch.full_like(flat[~hidden], 0.3), rtol=1e-4, atol=1e-5)
    assert (flat[hidden] == 0.7).all()


@pytest.mark.parametrize("kind", ["mesh", "hull", "points"])
def test_every_start_shows_the_object(seen, kind):
    config = ReconstructionConfig(start=kind, budget=1500)
    points, _ = trimesh.sample.sample_surface(ball_mesh(), 600, seed=0)
    start = start_field(seen, config, mesh=ball_mesh(), points=points)
    assert start.kind == kind and len(start.field) <= config.budget
    scores = [one for one, _ in score_views(start.field, seen)]
    assert np.mean([one.mask_iou for one in scores]) > {"mesh": 0.85, "hull": 0.8, "points": 0.7}[kind]
    assert np.mean([one.psnr for one in scores]) > {"mesh": 19, "hull": 16, "points": 15}[kind]
    start.field.check_values()


def test_a_start_that_is_not_possible_is_refused(seen):
    for kind in ("mesh", "points"):
        with pytest.raises(InputError, match="start"):
            start_field(seen, ReconstructionConfig(start=kind))
    with pytest.raises(InputError, match="points"):
        start_field(seen, ReconstructionConfig(start="points"), points=np.zeros((9, 3)))


def test_the_start_covers_the_body(seen):
    mesh = ball_mesh()
    start = start_field(seen, ReconstructionConfig(budget=2000, filler_share=0.2), mesh=mesh)
    found = measure_coverage(start.field, mesh, margin=0.0005, samples=3000)
    assert found.volume > 0.95 and found.surface > 0.99 and found.gaps < 0.02 and found.outside < 0.03
    shell = start.field.select(torch.arange(len(start.field) - start.fillers))
    assert measure_coverage(shell, mesh, margin=0.0005, samples=3000).volume < found.volume - 0.2
    with pytest.raises(InputError, match="watertight"):
        measure_coverage(shell, trimesh.Trimesh(mesh.vertices, mesh.faces[1:]), margin=0.0005)


def test_welding_closes_seams_of_textures():
    mesh = ball_mesh()
    torn = trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)
    assert not torn.is_watertight and welded(torn).is_watertight


def test_wrong_settings_are_refused(tmp_path):
    with pytest.raises(InputError, match="budget"):
        load_reconstruction_config(overrides=["budget=3"])
    with pytest.raises(InputError, match="colour"):
        load_reconstruction_config(overrides=["colour=3"])
    with pytest.raises(InputError, match="level_shares"):
        load_reconstruction_config(level_shares=(0.5, 0.2, 0.2))
    with pytest.raises(InputError, match="is not a file"):
        load_reconstruction_config(tmp_path / "none.yaml")
    path = tmp_path / "settings.yaml"
    path.write_text("budget: 700\n")
    assert load_reconstruction_config(path, overrides=["steps=9"], seed=4, start=None).model_dump(
        include={"budget", "steps", "seed", "start"}
    ) == {"budget": 700, "steps": 9, "seed": 4, "start": "auto"}


@pytest.mark.parametrize("count", [4, 5, 6, 7, 8, 9])
def test_hulls_of_more_or_fewer_points(count):
    wedge = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1], [1, 0, -1], [0, 1, -1]], dtype=float)
    octahedron = octahedra(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float))[0]
    for hull in (wedge, octahedron):
        (found,) = with_count(hull[None], count)
        assert found.shape == (count, 3)
        np.testing.assert_array_equal(found[:3], hull[:3])
        assert len(ConvexHull(found).vertices) == count  # each point is a corner
        volume = ConvexHull(hull).volume
        assert 0.2 * volume < ConvexHull(found).volume < 1.3 * volume


def test_with_three_points_the_outer_triangle_is_left():
    wedge = np.arange(18.0).reshape(1, 6, 3)
    np.testing.assert_array_equal(with_count(wedge, 3), wedge[:, :3])


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4, 8])
def test_a_reconstruction_has_the_points_that_were_asked_for(seen, count):
    config = ReconstructionConfig(budget=600, steps=12, refinements=2, points_per_convex=count)
    field = fit_field(begin(start_field(seen, config, mesh=ball_mesh())), seen, config).field()
    assert field.points.shape[1] == count
    assert np.mean([one.psnr for one, _ in score_views(field, seen)]) > 18
