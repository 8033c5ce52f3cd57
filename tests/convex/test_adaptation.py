"""A field is split where a motion bends its convexes, and stays as it is where it does not."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.convex import (
    ConvexField,
    DeformationMap,
    adapt_to_motion,
    advect,
    affine_map,
    bent_frames,
    inside_union,
    non_affinity,
    split,
    tet_map,
)
from physconvex.io import look_at
from physconvex.mesh import box_mesh
from physconvex.reconstruction import psnr
from physconvex.render import render
from tests.convex.fields import cube

CAMERA = look_at((0.0, -2.5, 0.3), (0.0, 0.0, 0.1), width=96, height=64, vertical_field_of_view=0.42)
PIXEL = 2.5 / CAMERA.fl_y


def bar(parts: int = 1) -> ConvexField:
    """A bar of 1 × 0.1 × 0.1 m, of equal convexes along it."""
    one, width = cube(), 1.0 / parts
    sizes = one.points.new_tensor([width, 0.1, 0.1]) / one.points.amax() / 2
    places = one.points.new_tensor([[(k + 0.5) * width - 0.5, 0, 0] for k in range(parts)])
    field = one.select(torch.zeros(parts, dtype=torch.long))
    field = field.with_points(field.points * sizes + places[:, None])
    sharp = torch.full((parts,), 400.0).to(field.points)
    return ConvexField(field.points, sharp, torch.ones_like(sharp), torch.ones_like(sharp), field.harmonics)


def bent(*curvatures: float) -> DeformationMap:
    """The bar along x bent to circles about the y axis, in one state per curvature [1/m]."""

    def one(points: torch.Tensor, curvature: float) -> tuple[torch.Tensor, torch.Tensor]:
        x, y, z = points.unbind(-1)
        radius = 1 / curvature
        sine, cosine, reach = (x / radius).sin(), (x / radius).cos(), radius - z
        zero, unit = torch.zeros_like(x), torch.ones_like(x)
        gradient = [cosine * reach / radius, zero, -sine, zero, unit, zero, sine * reach / radius, zero, cosine]
        moved = torch.stack([reach * sine, y, radius - reach * cosine], -1)
        return moved, torch.stack(gradient, -1).reshape(-1, 3, 3)

    def deform(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        positions, gradients = zip(*(one(points, curvature) for curvature in curvatures), strict=True)
        return torch.stack(positions), torch.stack(gradients)

    return deform


def single(curvature: float) -> DeformationMap:
    several = bent(curvature)
    return lambda points: tuple(part[0] for part in several(points))  # type: ignore[return-value]


def picture(field: ConvexField, deform: DeformationMap) -> torch.Tensor:
    return render(advect(field, deform).to(torch.float32), CAMERA, background=torch.ones(3)).colour.clamp(0, 1)


def test_a_bent_bar_of_few_convexes_looks_as_one_of_many():
    """Two long convexes, split for a motion, against 64 short ones that are as good as exact."""
    few, motion = bar(2), bent(0.5, 1.2, 2.0)
    found = adapt_to_motion(few, motion, distance=0.25 * PIXEL, limit=200)
    assert found.given == 2 and 2 < len(found.field) <= found.split < 64
    assert found.off_affine[0] > 2 * PIXEL > 0.25 * PIXEL >= found.off_affine[1]
    assert set(found.sources.tolist()) == {0, 1}
    probes = np.random.default_rng(0).uniform(-0.6, 0.6, (4000, 3)) * [1.0, 0.15, 0.15]
    np.testing.assert_array_equal(inside_union(found.field, probes), inside_union(few, probes))
    exact = picture(bar(64), single(2.0))
    plain, adapted = (psnr(picture(field, single(2.0)), exact) for field in (few, found.field))
    assert adapted > plain + 6.0
    assert found.to_json()["merged"] == len(found.field)


def test_all_states_of_a_motion_count():
    two, mild = (float(non_affinity(bar(), bent(*states))) for states in ((0.3, 2.0), (0.3,)))
    assert two == pytest.approx(float(non_affinity(bar(), single(2.0)))) and mild < 0.3 * two
    slight, strong = (adapt_to_motion(bar(), bent(k), distance=1e-3, limit=100).split for k in (0.3, 2.0))
    assert slight < strong == adapt_to_motion(bar(), bent(0.3, 2.0), distance=1e-3, limit=100).split


def test_an_affine_motion_splits_nothing_and_merges_nothing():
    parts = split(bar(), torch.tensor([True])).field
    found = adapt_to_motion(parts, affine_map(torch.eye(3) * 2, torch.ones(3)), distance=1e-6, limit=100)
    assert found.field is parts and (found.given, found.split) == (2, 2) and found.off_affine[1] < 1e-12


def test_parts_that_need_not_be_apart_are_merged_again():
    """A bar with a kink in the middle, across which the first cut through its middle does not go."""

    def kink(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        beyond = (points[:, 0] - 0.25).clamp(min=0)
        gradient = torch.eye(3).to(points).repeat(len(points), 1, 1)
        gradient[:, 2, 0] = (beyond > 0).to(points)
        return points + beyond[:, None] * points.new_tensor([0.0, 0.0, 1.0]), gradient

    found = adapt_to_motion(bar(), kink, distance=1e-3, limit=100)
    # halves, then quarters: the kink lies at the end of the third quarter, which merges with the first half
    assert found.split == 3 and len(found.field) == 2 and found.off_affine[1] < 1e-9


def test_the_limit_holds_and_a_wrong_distance_is_refused():
    found = adapt_to_motion(bar(4), bent(2.0), distance=1e-6, limit=7)
    assert found.split <= 7
    assert adapt_to_motion(bar(4), bent(2.0), distance=1e-6, limit=4).split == 4
    with pytest.raises(InputError, match="distance: got 0"):
        adapt_to_motion(bar(), bent(2.0), distance=0.0, limit=10)


def test_the_most_bent_frames_are_found():
    rest = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 3))
    bend = np.stack([0 * rest[:, 0], 0 * rest[:, 0], rest[:, 0] ** 2], axis=1)
    sway = np.stack([0 * rest[:, 0], rest[:, 2] ** 2, 0 * rest[:, 0]], axis=1)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    positions = np.stack([rest, rest @ turn.T + 1.0, rest + 0.1 * bend, rest + 0.2 * bend, rest + 0.05 * sway])
    assert bent_frames(rest, positions, distance=1e-4).tolist()[-2:] == [3, 4]
    assert bent_frames(rest, positions, distance=0.02).tolist() == [3]
    assert len(bent_frames(rest, positions[:2], distance=1e-4)) == 1


def test_a_map_of_several_states_of_a_mesh_is_that_of_each():
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=2)
    rng = np.random.default_rng(1)
    states = mesh.vertices + rng.normal(scale=0.01, size=(3, *mesh.vertices.shape))
    points = torch.as_tensor(rng.uniform(0.02, 0.08, (7, 3)))
    together = tet_map(mesh, states)(points)
    alone = [tet_map(mesh, state)(points) for state in states]
    for part in (0, 1):
        torch.testing.assert_close(together[part], torch.stack([one[part] for one in alone]))
