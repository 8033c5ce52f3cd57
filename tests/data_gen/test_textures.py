"""Procedural textures."""

import numpy as np
import pytest

from data_gen import floor_texture, vertex_colors
from data_gen.textures import PATTERNS, background_texture
from physconvex import InputError

POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (3000, 3))


@pytest.mark.parametrize("pattern", sorted(PATTERNS))
def test_solid_textures_are_repeatable_varied_and_independent_of_scale(pattern):
    first = vertex_colors(POINTS, np.random.default_rng(3), pattern=pattern)
    assert first.shape == (3000, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(first, vertex_colors(POINTS, np.random.default_rng(3), pattern=pattern))
    assert first.std(axis=0).max() > 2
    larger = vertex_colors(4.0 * POINTS, np.random.default_rng(3), pattern=pattern)
    np.testing.assert_array_equal(first, larger)  # a power of two: exact in floating point
    assert (first != vertex_colors(POINTS, np.random.default_rng(4), pattern=pattern)).any()


def test_solid_textures_depend_on_the_position_alone():
    order = np.random.default_rng(1).permutation(len(POINTS))
    for pattern in PATTERNS:
        straight = vertex_colors(POINTS, np.random.default_rng(5), pattern=pattern)
        shuffled = vertex_colors(POINTS[order], np.random.default_rng(5), pattern=pattern)
        np.testing.assert_array_equal(straight[order], shuffled)


def test_colours_differ_between_seeds():
    means = np.array([vertex_colors(POINTS, np.random.default_rng(s)).mean(axis=0) for s in range(40)])
    assert (means.std(axis=0) > 15).all()


@pytest.mark.parametrize("draw", [floor_texture, background_texture])
def test_pictures_are_repeatable_and_differ_between_seeds(draw):
    pictures = [draw(np.random.default_rng(s), 48) for s in range(12)]
    assert all(p.shape == (48, 48, 3) and p.dtype == np.uint8 for p in pictures)
    np.testing.assert_array_equal(pictures[0], draw(np.random.default_rng(0), 48))
    assert len({p.tobytes() for p in pictures}) == 12
    assert np.std([p.mean() for p in pictures]) > 8


@pytest.mark.wrong_types
def test_wrong_arguments_are_refused():
    with pytest.raises(InputError, match="pattern"):
        vertex_colors(POINTS, np.random.default_rng(0), pattern="tartan")
    with pytest.raises(InputError, match="points"):
        vertex_colors(np.zeros((3, 2)), np.random.default_rng(0))
    with pytest.raises(InputError, match="size"):
        floor_texture(np.random.default_rng(0), 1)
