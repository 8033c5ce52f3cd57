"""Meshes of few nodes judged by what they share with the body."""

import numpy as np
import pytest
import trimesh

from physconvex import ConvergenceError
from physconvex.mesh import TetMesh, box_mesh, mesh_of_few_nodes, meshing, shape_mismatch, to_quadratic


@pytest.fixture(scope="module")
def box():
    shown = trimesh.creation.box((0.4, 0.2, 0.1))
    return np.asarray(shown.vertices) + np.array([0.2, 0.1, 0.05]), np.asarray(shown.faces)


def meshed(scale):
    mesh = box_mesh((0.4, 0.2, 0.1), (2, 1, 1), order=1)
    return to_quadratic(TetMesh(mesh.vertices * scale, mesh.tets))


def test_what_only_one_of_body_and_mesh_has_counts(box):
    assert shape_mismatch(meshed(1.0), *box) == pytest.approx(0.0, abs=1e-9)
    assert shape_mismatch(meshed(np.array([0.75, 1.0, 1.0])), *box) == pytest.approx(0.25, abs=0.01)
    thicker = shape_mismatch(meshed(np.array([1.0, 1.0, 1.5])), *box)  # all of the surface lies in the mesh
    assert thicker == pytest.approx(1 / 3, abs=0.01)


def test_an_open_surface_is_judged_by_distance(box):
    vertices, faces = box
    lid = (np.abs(vertices[faces][..., 2] - 0.1) < 1e-9).all(1)
    assert shape_mismatch(meshed(1.0), vertices, faces[~lid]) == pytest.approx(0.0, abs=1e-9)
    shorter = shape_mismatch(meshed(np.array([0.75, 1.0, 1.0])), vertices, faces[~lid])  # half of them are 0.1 m away
    assert shorter == pytest.approx(np.sqrt(0.5) * 0.1 / 0.4, rel=1e-6)


def test_more_nodes_are_tried_until_the_body_is_there(box, monkeypatch):
    asked, made = [], {10: ConvergenceError("too few"), 20: meshed(0.8)}

    def tetrahedralize(surface, *, max_nodes, order, method):
        asked.append(max_nodes)
        if isinstance(made[max_nodes], ConvergenceError):
            raise made[max_nodes]
        return made[max_nodes]

    monkeypatch.setattr(meshing, "tetrahedralize", tetrahedralize)
    assert mesh_of_few_nodes(*box, max_nodes=10) is made[20]  # neither is good: the better one
    assert asked == [10, 20]
    made[10] = meshed(0.7)
    assert mesh_of_few_nodes(*box, max_nodes=10) is made[20]
    made[10] = meshed(1.0)
    assert mesh_of_few_nodes(*box, max_nodes=10) is made[10]
    made.update(dict.fromkeys(made, ConvergenceError("no mesh")))
    with pytest.raises(ConvergenceError, match="no mesh"):
        mesh_of_few_nodes(*box, max_nodes=10)


def test_near_an_open_surface_means_nearer_than_a_share_of_the_volume(box, monkeypatch):
    vertices, faces = box
    lid = (np.abs(vertices[faces][..., 2] - 0.1) < 1e-9).all(1)
    made = {10: meshed(np.array([0.9, 1.0, 1.0])), 20: meshed(1.0)}  # .07 of the size off, and not at all
    monkeypatch.setattr(meshing, "tetrahedralize", lambda surface, *, max_nodes, order, method: made[max_nodes])
    assert mesh_of_few_nodes(vertices, faces[~lid], max_nodes=10) is made[20]
