"""Splitting and merging conserve what is occupied."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.convex import (
    ConvexField,
    advect,
    affine_map,
    inside_union,
    merge,
    non_affinity,
    occupancies,
    split,
    split_until_affine,
)
from physconvex.convex.hull_points import _protrusions
from tests.convex.fields import cube, random_field
from tests.convex.hulls import hull_volumes


def bend(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A bar along x bent to a circle of radius 0.5 m about the y axis."""
    x, y, z = points.unbind(-1)
    sine, cosine, radius = (x / 0.5).sin(), (x / 0.5).cos(), 0.5 - z
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    gradient = [cosine * radius / 0.5, zero, -sine, zero, one, zero, sine * radius / 0.5, zero, cosine]
    return torch.stack([radius * sine, y, 0.5 - radius * cosine], -1), torch.stack(gradient, -1).reshape(-1, 3, 3)


def bar() -> ConvexField:
    field = cube()
    return field.with_points(field.points * field.points.new_tensor([1.0, 0.1, 0.1]))


def probes(field: ConvexField, count: int = 4000) -> np.ndarray:
    points = field.points.flatten(0, 1).numpy()
    return np.random.default_rng(0).uniform(points.min(axis=0), points.max(axis=0), (count, 3))


@pytest.mark.parametrize("points", [4, 6, 8])
def test_the_parts_of_a_split_fill_what_the_whole_did(points):
    field = random_field(5, points=points, seed=points)
    which = torch.tensor([True, False, True, True, False])
    division = split(field, which, keep_count=False)
    assert len(division.field) == 8
    assert division.sources.tolist() == [1, 4, 0, 0, 2, 2, 3, 3]
    np.testing.assert_allclose(hull_volumes(division.field).sum(), hull_volumes(field).sum(), rtol=1e-9)
    where = probes(field)
    np.testing.assert_array_equal(inside_union(division.field, where), inside_union(field, where))
    assert torch.equal(division.field.harmonics, field.harmonics[division.sources])


def test_with_the_number_of_points_kept_the_loss_is_what_is_stated():
    field = random_field(6, points=6, seed=3)
    division = split(field, torch.ones(6, dtype=torch.bool))
    assert division.field.points.shape == (12, 6, 3)
    before, after = hull_volumes(field).sum(), hull_volumes(division.field).sum()
    assert 0 < division.lost_volume < 0.2 * before
    np.testing.assert_allclose(before - after, division.lost_volume, rtol=1e-9)


def test_overlap_closes_the_seam_between_soft_parts():
    field = ConvexField(*(10 * tensor if at == 1 else tensor for at, tensor in enumerate(bar().tensors())))
    seam = np.zeros((1, 3))
    plain = split(field, torch.tensor([True])).field
    over = split(field, torch.tensor([True]), overlap=0.1).field
    before, cut, closed = (float(occupancies(one, seam)[1][0]) for one in (field, plain, over))
    assert cut < before - 0.1 and closed > before - 0.02


def test_bending_is_found_and_split_away():
    field = bar()
    straight = affine_map(torch.eye(3) * 2, torch.ones(3))
    assert float(non_affinity(field, straight)) < 1e-12
    before = float(non_affinity(field, bend))
    division = split_until_affine(field, bend, tolerance=0.01, limit=100)
    assert before > 0.1 and float(non_affinity(division.field, bend).max()) < 0.01
    # A bent bar whose middle line keeps its length keeps its volume (Pappus), and the parts fill it.
    moved = hull_volumes(advect(division.field, bend)).sum()
    assert moved == pytest.approx(float(hull_volumes(field)[0]), rel=0.01)
    assert hull_volumes(advect(field, bend)).sum() < 0.5 * moved  # the hull of eight moved corners
    assert len(split_until_affine(field, bend, tolerance=0.01, limit=5).field) <= 5


def test_the_deformation_is_evaluated_at_few_points_at_once(monkeypatch):
    """The corners of a part grow with every cut, and all pairs of them are asked for: that took 15 gigabytes."""
    field, asked = bar(), []

    def counted(points):
        asked.append(len(points))
        return bend(points)

    whole = split_until_affine(field, bend, tolerance=0.01, limit=100)
    monkeypatch.setattr("physconvex.convex.splitting.POINTS", 100)
    parts = split_until_affine(field, counted, tolerance=0.01, limit=100)
    assert max(asked) <= 100 and torch.allclose(parts.field.points, whole.field.points, atol=1e-6)


def fold(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A pyramid is pushed up in the middle: folds that meet, as the faces of finite elements do."""
    slopes = points.new_tensor([[1.0, 0, 0], [-1.0, 0, 0], [0, 2.0, 0], [0, -2.0, 0]])
    height, side = (0.2 - points @ slopes.T).min(dim=1)
    gradient = torch.eye(3).to(points).repeat(len(points), 1, 1)
    gradient[:, 2] -= slopes[side]
    return points + height[:, None] * points.new_tensor([0.0, 0.0, 1.0]), gradient


def test_at_folds_that_meet_splitting_ends_where_it_no_longer_matters():
    plate = cube()
    plate = plate.with_points(plate.points * plate.points.new_tensor([1.0, 0.6, 0.05]) + 0.013)
    endless = split_until_affine(plate, fold, tolerance=0.02, limit=10_000)
    assert float(non_affinity(endless.field, fold).max()) > 0.02  # at the tip the folds meet however small the part
    ended = split_until_affine(plate, fold, tolerance=0.02, limit=10_000, least=0.08)
    assert 2 < len(ended.field) < 0.6 * len(endless.field)


@pytest.mark.filterwarnings("error")
def test_a_corner_in_no_face_goes_first():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.2, 0.2]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    found = _protrusions(corners, faces)
    assert found[4] == 0 and (found[:4] > 0).all()


def test_soft_parts_with_overlap_let_no_light_through_when_bent():
    soft = ConvexField(*(200 * tensor if at == 1 else tensor for at, tensor in enumerate(bar().tensors())))
    inside = np.stack(np.meshgrid(np.linspace(-0.45, 0.45, 181), [0.0], [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    plain, over = (split_until_affine(soft, bend, tolerance=0.01, limit=100, overlap=by).field for by in (0.0, 3.0))
    whole, cut, closed = (occupancies(one, inside)[1].min() for one in (soft, plain, over))
    assert whole - cut > 0.1 and whole - closed < 0.02
    moved = bend(torch.as_tensor(inside))[0].numpy()
    assert occupancies(advect(over, bend), moved)[1].min() > whole - 0.02
    np.testing.assert_array_equal(inside_union(over, probes(soft)), inside_union(soft, probes(soft)))


def test_merging_undoes_a_split_and_conserves_occupancy():
    field = bar()
    parts = split(field, torch.tensor([True])).field
    parts = split(parts, torch.tensor([True, True])).field
    assert len(parts) == 4
    once = merge(parts)
    twice = merge(once.field)
    assert (len(once.field), len(twice.field)) == (2, 1)
    where = probes(field)
    np.testing.assert_array_equal(inside_union(twice.field, where), inside_union(field, where))
    assert len(merge(parts, limit=3).field) == 3


def test_flat_convexes_split_into_flat_ones_and_do_not_merge():
    corners = torch.tensor([[0, 0, 0], [4, 0, 0], [2.0, 1, 0]]).double()
    triangle = random_field(1, points=3).with_points(corners[None])
    whole = split(triangle, torch.tensor([True]))  # through the corner in the middle
    areas = 0.5 * torch.linalg.det(whole.field.points[:, 1:, :2] - whole.field.points[:, :1, :2]).abs()
    torch.testing.assert_close(areas, torch.tensor([1.0, 1.0]).double())
    assert len(merge(whole.field).field) == 2
    oblique = {"normals": torch.tensor([[0.0, 1, 0]]).double()}  # the lower part has four corners
    kept, fewer = (
        split(triangle, torch.tensor([True]), **oblique, keep_count=keep).field.points for keep in (False, True)
    )
    assert kept.shape == (2, 4, 3) and fewer.shape == (2, 3, 3)
    lower = fewer[fewer[..., 1].amin(dim=1) == 0]
    assert np.linalg.norm(np.cross(*(lower[0, 1:] - lower[0, 0]))) == pytest.approx(2.0)  # of 3 in both halves


def test_what_differs_in_colour_or_place_is_not_merged():
    parts = split(bar(), torch.tensor([True])).field
    painted = ConvexField(*parts.tensors()[:4], parts.harmonics + torch.tensor([0.0, 0.5])[:, None, None])
    assert len(merge(painted).field) == 2
    apart = parts.with_points(parts.points * 1.0 + torch.tensor([[[0.0, 0, 0]], [[0.3, 0, 0]]]))
    assert len(merge(apart).field) == 2
    assert len(merge(parts).field) == 1


@pytest.mark.wrong_types
def test_wrong_arguments_are_refused():
    field = bar()
    with pytest.raises(InputError, match="which"):
        split(field, torch.tensor([1]))
    with pytest.raises(InputError, match="tolerance"):
        split_until_affine(field, bend, tolerance=0.0, limit=5)
    for wrong in ({"overlap": -1.0}, {"least": -1.0}):
        with pytest.raises(InputError, match="least, overlap"):
            split_until_affine(field, bend, tolerance=0.1, limit=5, **wrong)
    with pytest.raises(InputError, match="tolerances"):
        merge(field, volume_tolerance=-1.0)
