"""What a fit has left open is closed without changing an image."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from physconvex import InputError
from physconvex.convex import ConvexField, inside_union, union_samples
from physconvex.io import look_at
from physconvex.reconstruction import ReconstructionConfig, fill_gaps, start_field
from physconvex.reconstruction.gap_filling import grown_boxes
from physconvex.render import render
from tests.convex.hulls import hull_volumes
from tests.reconstruction.scenes import RADIUS, ball_mesh, views
from train import measure_coverage


def test_boxes_hold_all_that_is_wanted_and_nothing_that_is_not_allowed():
    rng = np.random.default_rng(0)
    allowed = rng.random((9, 8, 7)) < 0.9
    wanted = allowed & (rng.random(allowed.shape) < 0.3)
    boxes, gains = grown_boxes(wanted, allowed)
    held = np.zeros_like(allowed)
    for first, last in boxes:
        held[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] = True
    assert (held >= wanted).all() and not (held & ~allowed).any()
    assert gains.sum() == wanted.sum() and gains.min() > 0 and len(boxes) < wanted.sum()


def with_hole() -> tuple[ConvexField, float]:
    """A ball's first convexes without those of its lower half."""
    config = ReconstructionConfig(budget=600, start_share=0.9)
    start = start_field(views(3), config, mesh=ball_mesh())
    return start.field.select(start.field.centres[:, 2] > -0.01), start.footprint


def test_gaps_are_filled_within_the_body_and_unseen() -> None:
    field, footprint = with_hole()
    filled = fill_gaps(field, ball_mesh(), footprint=0.4 * footprint, budget=2000 + len(field))
    before, after = (measure_coverage(one, ball_mesh(), margin=0.5 * footprint) for one in (field, filled))
    assert before.volume < 0.7 and after.volume > 0.95
    assert before.gaps > 0.3 and after.gaps < 0.05
    assert after.outside < 0.05
    camera = look_at((0, -0.4, -0.1), (0, 0, 0), width=40, height=40, vertical_field_of_view=0.4)
    assert torch.equal(render(field, camera).colour, render(filled, camera).colour)


def test_few_convexes_fill_the_largest_gaps_and_none_are_added_where_all_is_covered() -> None:
    field, footprint = with_hole()
    field = field.select(field.opacity > 0.5)  # without the fillers of its start, which would be replaced
    filled = fill_gaps(field, ball_mesh(), footprint=footprint, budget=len(field) + 11)
    added = filled.select(torch.arange(len(filled)) >= len(field))
    assert len(added) == 10
    assert hull_volumes(added).sum() > 0.1 * 4 / 3 * np.pi * RADIUS**3
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    whole = fill_gaps(filled, ball_mesh(), footprint=footprint, budget=len(field) + 1000)
    assert inside_union(whole, box.vertices * 0.9).all()
    assert len(fill_gaps(whole, ball_mesh(), footprint=footprint, budget=len(field) + 1000)) == len(whole)
    drawn = replace(whole, opacity=torch.ones(len(whole)))
    assert len(fill_gaps(drawn, box, footprint=footprint, budget=len(drawn) + 50)) == len(whole)


def test_samples_of_a_filled_body_have_its_mass_and_inertia_however_its_hulls_overlap():
    field, footprint = with_hole()
    ball = ball_mesh()
    filled = fill_gaps(field, ball, footprint=0.4 * footprint, budget=2000 + len(field))
    twice = ConvexField.joined([filled, filled])
    samples = union_samples(twice, ball, cells=40)
    mass = samples.mass
    assert mass.volume == pytest.approx(ball.volume, rel=0.01)
    assert samples.interior.volume == pytest.approx(mass.volume, rel=1e-9)
    assert np.abs(mass.weights @ mass.points / mass.volume).max() < 0.01 * RADIUS
    moment = mass.weights @ np.square(mass.points[:, :2]).sum(axis=1)
    assert moment == pytest.approx(0.4 * ball.volume * RADIUS**2, rel=0.015)
    assert samples.surface_areas.sum() == pytest.approx(ball.area, rel=1e-6)
    assert (samples.mass.cells.max() + 1) == samples.interior.cell_count < 1500


def test_hulls_beside_the_body_give_no_samples():
    field, _ = with_hole()
    moved = field.with_points(field.points + 1.0)
    with pytest.raises(InputError, match="its hulls fill 0 of the 20³ boxes inside the surface"):
        union_samples(moved, ball_mesh(), cells=20)
    assert union_samples(None, ball_mesh(), cells=20).mass.volume == pytest.approx(ball_mesh().volume, rel=0.03)
