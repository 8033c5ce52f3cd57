"""Tractions as nodal forces: total force, moments, exactness, selection, errors."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.fem import surface_load
from physconvex.mesh import box_mesh

MESH = {order: box_mesh((0.4, 0.3, 0.2), (2, 2, 1), order=order) for order in (1, 2)}


def right(centroids: np.ndarray) -> np.ndarray:
    return np.isclose(centroids[:, 0], 0.4)


@pytest.mark.parametrize("order", [1, 2])
def test_total_force_and_moment_of_a_uniform_traction(order):
    mesh, traction = MESH[order], np.array([1.0, -2.0, 5.0])
    forces = surface_load(mesh, right, traction)
    np.testing.assert_allclose(forces.sum(0), traction * 0.3 * 0.2)
    middle = np.array([0.4, 0.15, 0.1])
    np.testing.assert_allclose(np.cross(mesh.vertices - middle, forces).sum(0), 0.0, atol=1e-14)
    assert (forces[mesh.vertices[:, 0] < 0.399] == 0).all()


@pytest.mark.parametrize("order", [1, 2])
def test_uniform_pressure_all_around_is_balanced(order):
    mesh = MESH[order]
    x = mesh.vertices[mesh.boundary_faces[:, :3]]
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    forces = surface_load(mesh, np.ones(len(normals), dtype=bool), 7.0 * normals)
    np.testing.assert_allclose(forces.sum(0), 0.0, atol=1e-14)
    # virial of a pressure: Σ x·f = 3 p V, since the shape functions reproduce x
    assert (mesh.vertices * forces).sum() == pytest.approx(3 * 7.0 * mesh.volume)


@pytest.mark.parametrize("order", [1, 2])
def test_work_of_a_varying_traction_is_exact(order):
    mesh = MESH[order]

    def traction(p):
        return np.column_stack([p[:, 1] ** 2, p[:, 1] * p[:, 2], np.ones(len(p))])

    forces = surface_load(mesh, right, traction)
    y, z = mesh.vertices[:, 1], mesh.vertices[:, 2]
    # ∫ y² dA = w³/3 h; ∫ yz dA = w²/2 h²/2 over w = 0.3, h = 0.2
    np.testing.assert_allclose(forces.sum(0), [0.3**3 / 3 * 0.2, 0.3**2 / 2 * 0.2**2 / 2, 0.06])
    # work on the displacement u = (z, y, y): ∫ y² z + y² z + y
    np.testing.assert_allclose(forces[:, 0] @ z + forces[:, 1] @ y + forces[:, 2] @ y, 2 * 0.009 * 0.02 + 0.045 * 0.2)
    if order == 2:  # and on a quadratic one: ∫ y² · y² dA
        np.testing.assert_allclose(forces[:, 0] @ y**2, 0.3**5 / 5 * 0.2)


def test_masks_indices_and_functions_choose_the_same():
    mesh = MESH[2]
    mask = right(mesh.vertices[mesh.boundary_faces[:, :3]].mean(1))
    forces = [surface_load(mesh, faces, (0, 0, 1.0)) for faces in (mask, np.flatnonzero(mask), right)]
    np.testing.assert_array_equal(forces[0], forces[1])
    np.testing.assert_array_equal(forces[0], forces[2])


@pytest.mark.parametrize(
    ("faces", "traction", "message"),
    [
        (lambda c: c[:, 0] > 9, (0, 0, 1.0), "faces: got none"),
        (np.ones(3, dtype=bool), (0, 0, 1.0), "faces: got a mask of shape"),
        (np.array([10**6]), (0, 0, 1.0), "faces: expected indices"),
        (right, (0, 1.0), "traction: got shape"),
    ],
)
def test_bad_input_is_named(faces, traction, message):
    with pytest.raises(InputError, match=message):
        surface_load(MESH[1], faces, traction)
