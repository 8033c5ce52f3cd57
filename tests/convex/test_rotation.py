"""Rotated harmonics against direct evaluation; polar rotations."""

import pytest
import torch

from physconvex.convex import harmonic_basis, polar_rotation, rotate_harmonics
from physconvex.render import slopes


def rotations(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return polar_rotation(torch.randn(count, 3, 3, generator=generator, dtype=torch.float64))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_was_seen_along_d_is_seen_along_the_rotated_d(degree):
    generator = torch.Generator().manual_seed(degree)
    harmonics = torch.randn(7, (degree + 1) ** 2, 3, generator=generator, dtype=torch.float64)
    directions = torch.randn(20, 3, generator=generator, dtype=torch.float64)
    directions = directions / directions.norm(dim=1, keepdim=True)
    turns = rotations(7)
    rotated = rotate_harmonics(harmonics, turns)
    before = torch.einsum("qs,nsc->nqc", harmonic_basis(directions, degree), harmonics)
    turned = torch.einsum("nij,qj->nqi", turns, directions)
    after = torch.einsum("nqs,nsc->nqc", harmonic_basis(turned, degree), rotated)
    torch.testing.assert_close(after, before, rtol=0, atol=1e-13)


def test_rotations_compose_and_keep_the_norm():
    harmonics = torch.randn(5, 16, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    first, second = rotations(5, 1), rotations(5, 2)
    twice = rotate_harmonics(rotate_harmonics(harmonics, first), second)
    torch.testing.assert_close(twice, rotate_harmonics(harmonics, second @ first), rtol=0, atol=1e-13)
    torch.testing.assert_close(twice.square().sum((1, 2)), harmonics.square().sum((1, 2)))


def test_the_polar_rotation_undoes_a_stretch_and_has_determinant_one():
    turns = rotations(6)
    stretch = torch.randn(6, 3, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    stretch = stretch @ stretch.transpose(1, 2) + 0.1 * torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(polar_rotation(turns @ stretch), turns)
    inverted = polar_rotation(-turns)
    torch.testing.assert_close(torch.det(inverted), torch.ones(6, dtype=torch.float64))


def test_the_polar_rotation_has_the_derivative_of_differences_also_at_rest_and_inverted():
    generator = torch.Generator().manual_seed(0)
    gradients = torch.eye(3, dtype=torch.float64).repeat(4, 1, 1)
    gradients[1:] += 0.3 * torch.randn(3, 3, 3, generator=generator, dtype=torch.float64)
    gradients[3, :, 2] *= -1
    assert torch.det(gradients[3]) < 0
    way = torch.randn(4, 3, 3, generator=generator, dtype=torch.float64)
    (found,) = slopes(lambda at: (polar_rotation(at),), gradients, way[None])
    step = 1e-6
    expected = (polar_rotation(gradients + step * way) - polar_rotation(gradients - step * way)) / (2 * step)
    torch.testing.assert_close(found[0], expected, rtol=1e-6, atol=1e-8)


def test_outputs_that_stay_have_no_slope():
    at, ways = torch.tensor([1.0, 2.0]), torch.eye(2)
    moving, still = slopes(lambda x: (x.square().sum()[None], torch.ones(3)), at, ways)
    assert still is None
    torch.testing.assert_close(moving, torch.tensor([[2.0], [4.0]]))
