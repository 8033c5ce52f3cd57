"""What covers a body, and what lets light through it."""

import math

import pytest

from physconvex import InputError
from physconvex.convex import ConvexField
from tests.reconstruction.scenes import RADIUS, ball_mesh, striped_ball
from train import measure_coverage
from train.reconstruction_coverage import measure_holes

PIXEL = RADIUS / 24


def without_caps(field: ConvexField) -> ConvexField:
    """A ball open at the top and at the bottom: light passes along the vertical axis alone."""
    return field.select(field.centres[:, 2].abs() < 0.8 * RADIUS)


def test_light_passes_where_a_shell_is_open_on_both_sides_and_nowhere_else() -> None:
    closed = measure_holes(striped_ball(), ball_mesh(), pixel=PIXEL, directions=8)
    assert closed.share == 0 and closed.worst == 0 and closed.directions == 8
    # discs of the ball's radius less two pixels, seen in perspective
    assert closed.rays == pytest.approx(8 * math.pi * 22**2, rel=0.1)
    opened = measure_holes(without_caps(striped_ball()), ball_mesh(), pixel=PIXEL, directions=8)
    assert 0 < opened.share < opened.worst < 0.3
    with pytest.raises(InputError, match="holes"):
        measure_holes(striped_ball(), ball_mesh(), pixel=0.0)


def test_a_closed_shell_is_solid_at_its_surface_and_hollow_inside() -> None:
    found = measure_coverage(striped_ball(), ball_mesh(), margin=0.5 * PIXEL, samples=500)
    assert found.drawn_volume == found.volume == pytest.approx(1 - 0.8**3, abs=0.07)
    surface, below, deeper = found.soft_surface
    assert [round(one.depth / found.margin) for one in (surface, below, deeper)] == [0, 2, 4]
    assert surface.union > 0.95 and below.union > 0.99 and deeper.union > 0.99
    assert all(one.single <= one.union for one in found.soft_surface)
    faint = striped_ball()
    faint = ConvexField(faint.points, faint.smoothness, faint.sharpness, 0.4 * faint.opacity, faint.harmonics)
    pale = measure_coverage(faint, ball_mesh(), margin=0.5 * PIXEL, samples=500)
    assert all(one.single == 0 for one in pale.soft_surface) and pale.volume == found.volume
    assert pale.holes.share > 0.1
