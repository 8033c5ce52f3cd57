"""Rotated harmonics against direct evaluation; polar rotations."""

import pytest
import torch

from physconvex.convex import harmonic_basis, polar_rotation, rotate_harmonics


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
