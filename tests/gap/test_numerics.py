"""What runs of other meshes say of the error of the one that is used."""

import numpy as np
import pytest

from physconvex.gap.numerics import Numerics

STILL = np.zeros((4, 3, 3))
NODES = (250, 1000)
BY_COARSER, BY_FINER = 1 / (4 ** (1.75 / 3) - 1), 2.5 ** (1.75 / 3) / (2.5 ** (1.75 / 3) - 1)


def mesh_error(coarser, finer):
    finest = None if finer is None else STILL + finer
    numerics = Numerics(STILL, STILL + coarser, STILL, STILL, STILL, nodes=NODES, finest=finest)
    return numerics.null[1]


def test_richardson_with_either_mesh():
    """Of an error that falls with nodes^(-1.75/3), both differences give what the used mesh errs by."""
    errors = {n: n ** (-1.75 / 3) for n in (250, 1000, 2500)}
    coarser, finer = errors[250] - errors[1000], errors[1000] - errors[2500]
    assert mesh_error(coarser, None) == pytest.approx(STILL + errors[1000])
    assert coarser * BY_COARSER == pytest.approx(errors[1000]) and finer * BY_FINER == pytest.approx(errors[1000])


def test_the_lesser_estimate_is_believed():
    assert mesh_error(10.0, 0.1) == pytest.approx(STILL + 0.1 * BY_FINER)  # the coarse mesh flew on otherwise
    assert mesh_error(0.1, 10.0) == pytest.approx(STILL + 0.1 * BY_COARSER)  # the finest did
