"""What runs on several meshes say of the error of the finest."""

import numpy as np
import pytest

from physconvex.gap.numerics import Numerics, correction_of


def converging(rng, rate, nodes):
    """Differences of runs whose errors fall with that power of the number of nodes, and the errors."""
    shape = rng.normal(size=(5, 7, 3)) * np.arange(5)[:, None, None]
    errors = [shape * float(n) ** -rate for n in nodes]
    zero = np.zeros_like(shape)
    finest = errors[1] - errors[2] if len(nodes) == 3 else None
    numerics = Numerics(zero, errors[0] - errors[1], zero, zero, zero, nodes=tuple(nodes), finest=finest)
    return numerics, errors


@pytest.mark.parametrize("rate", [0.6, 1.0])
def test_three_meshes_tell_the_error_of_the_finest(rng, rate):
    numerics, errors = converging(rng, rate, (200, 900, 1900))
    assert np.abs(numerics.null[1] - errors[2])[1:].max() < 0.02 * np.abs(errors[2]).max() or rate < 0.65
    # where Richardson's factor exceeds one, the difference itself is taken: it is most of the error
    assert np.linalg.norm(numerics.null[1]) <= 1.02 * np.linalg.norm(errors[2])
    assert np.linalg.norm(numerics.null[1]) > 0.4 * np.linalg.norm(errors[2])


def test_fast_convergence_is_not_credited_with_the_difference_of_two_meshes(rng):
    """A mesh of 200 nodes may be far off while 900 and 1900 agree."""
    numerics, errors = converging(rng, 1.2, (200, 900, 1900))
    two = Numerics(numerics.steps, numerics.mesh, numerics.contact, numerics.steps, numerics.steps, nodes=(200, 900))
    assert np.linalg.norm(numerics.null[1]) < 0.35 * np.linalg.norm(two.null[1])
    assert np.linalg.norm(numerics.null[1]) >= 0.99 * np.linalg.norm(errors[2])


def test_the_model_is_corrected_by_the_finest_run(rng):
    numerics, errors = converging(rng, 0.6, (200, 900, 1900))
    assert np.allclose(correction_of(numerics), numerics.mesh + numerics.finest)  # no finer mesh to run the model on
    assert np.allclose(errors[0] - correction_of(numerics), errors[2])
