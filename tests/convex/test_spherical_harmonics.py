"""Spherical harmonics against the definition, colours."""

import numpy as np
import torch
from scipy.special import sph_harm_y

from physconvex.convex import coefficients_of_colour, harmonic_basis, view_colours


def directions(count: int) -> torch.Tensor:
    raw = torch.as_tensor(np.random.default_rng(0).normal(size=(count, 3)))
    return raw / raw.norm(dim=1, keepdim=True)


def test_basis_is_the_real_form_of_the_complex_harmonics() -> None:
    unit = directions(20).numpy()
    theta, phi = np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0])
    basis = harmonic_basis(torch.as_tensor(unit), 3).numpy()
    for level in range(4):
        for order in range(-level, level + 1):
            complex_value = (
                sph_harm_y(level, abs(order), theta, phi) * (-1) ** order
            )  # scipy has the Condon–Shortley sign
            part = complex_value.real if order >= 0 else complex_value.imag
            expected = part * (np.sqrt(2) if order else 1)
            np.testing.assert_allclose(basis[:, level * (level + 1) + order], expected, atol=1e-12)


def test_basis_is_orthonormal() -> None:
    z, weights = np.polynomial.legendre.leggauss(8)  # exact for the polynomials of degree 6 in z
    angle = np.arange(8) * 2 * np.pi / 8  # exact up to the seventh harmonic
    z_grid, angle_grid = np.meshgrid(z, angle, indexing="ij")
    radius = np.sqrt(1 - z_grid**2)
    unit = np.stack([radius * np.cos(angle_grid), radius * np.sin(angle_grid), z_grid], axis=-1)
    basis = harmonic_basis(torch.as_tensor(unit), 3).numpy()
    gram = np.einsum("i,ijs,ijt->st", weights * 2 * np.pi / 8, basis, basis)
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-12)


def test_constant_colours_come_back_and_dark_ones_stop_at_zero() -> None:
    colours = torch.tensor([[0.2, 0.5, 1.0], [0.0, 0.9, 0.4]], dtype=torch.float64)
    torch.testing.assert_close(view_colours(coefficients_of_colour(colours), directions(2)), colours)
    assert (view_colours(coefficients_of_colour(colours - 2), directions(2)) == 0).all()
