"""Cubature with few weighted points against that of all tetrahedra."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.errors import InputError
from physconvex.fem import ElasticBody, box_mesh
from physconvex.inelastic import Plasticine
from physconvex.reduced import (
    BodySamples,
    Cubature,
    ReducedBody,
    ReducedSpace,
    eigenmode_weights,
    optimised_cubature,
)
from physconvex.reduced.optimised_cubature import nonnegative_least_squares


def stiffness_ratios(body: ReducedBody, interior: Cubature) -> np.ndarray:
    """Stiffness of each elastic mode of the rest state with other samples over that with all."""
    space = ReducedSpace(body.space.field, replace(body.space.samples, interior=interior))
    other = ReducedBody(space, youngs_modulus=body.youngs_modulus, poisson_ratio=body.poisson_ratio)
    values, modes = np.linalg.eigh(body.hessian(body.rest))
    modes = modes[:, 6:] / np.sqrt(values[6:])  # rigid motions have no stiffness
    return np.linalg.eigvalsh(modes.T @ other.hessian(other.rest) @ modes)


def test_few_points_keep_volume_and_stiffness_and_random_ones_do_not():
    full = ElasticBody(box_mesh((0.3, 0.2, 0.1), (3, 2, 2)))
    space = ReducedSpace(eigenmode_weights(full, 3), BodySamples.of_mesh(full.mesh))
    body, interior = ReducedBody(space), space.samples.interior
    most = 7 * space.dimension
    assert most < 0.4 * len(interior.weights)
    found = optimised_cubature(body, most, generator=np.random.default_rng(0))
    assert len(found.weights) <= most and (found.weights > 0).all()
    assert found.volume == pytest.approx(interior.volume, rel=1e-12)
    ratios = stiffness_ratios(body, found)
    assert 0.95 < ratios.min() and ratios.max() < 1.05
    pick = np.random.default_rng(0).choice(len(interior.weights), most, replace=False)
    share = interior.weights[pick] * interior.volume / interior.weights[pick].sum()
    random = stiffness_ratios(body, Cubature(interior.points[pick], share, interior.cells[pick], interior.cell_count))
    assert random.min() < 0.9 and random.max() > 1.1


def test_weights_are_those_of_the_bounded_problem():
    from scipy.optimize import nnls

    rng = np.random.default_rng(1)
    matrix, right = rng.normal(size=(30, 20)), rng.normal(size=30)
    found = nonnegative_least_squares(matrix.T @ matrix, matrix.T @ right, most=20, tolerance=1e-12)
    np.testing.assert_allclose(found, nnls(matrix, right)[0], atol=1e-9)


def test_flowing_bodies_and_no_points_are_refused(mixed_body):
    generator = np.random.default_rng(0)
    with pytest.raises(InputError, match="flow"):
        optimised_cubature(ReducedBody(mixed_body(1).space, flow=Plasticine(1e3)), generator=generator)
    with pytest.raises(InputError, match="points"):
        optimised_cubature(mixed_body(1), 0, generator=generator)
