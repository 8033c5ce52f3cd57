"""Meshes of few nodes judged by how far they lie from the surface."""

import numpy as np
import pytest
import trimesh

from physconvex.errors import ConvergenceError
from physconvex.fem import TetMesh, box_mesh, to_quadratic
from physconvex.identify import faithful
from physconvex.identify.faithful import faithful_mesh, unfaithfulness


@pytest.fixture(scope="module")
def box():
    shown = trimesh.creation.box((0.4, 0.2, 0.1))
    return np.asarray(shown.vertices) + np.array([0.2, 0.1, 0.05]), np.asarray(shown.faces)


def meshed(scale):
    mesh = box_mesh((0.4, 0.2, 0.1), (2, 1, 1), order=1)
    return to_quadratic(TetMesh(mesh.vertices * scale, mesh.tets))


def test_distance_and_volume_count(box):
    assert unfaithfulness(meshed(1.0), *box) == pytest.approx(0.0, abs=1e-9)
    shorter = unfaithfulness(meshed(np.array([0.75, 1.0, 1.0])), *box)  # half of the vertices are 0.1 m away
    assert shorter == pytest.approx(np.sqrt(0.5) * 0.1 / 0.4 + 0.1 * 0.25, rel=1e-6)


def test_more_nodes_are_tried_until_the_body_is_there(box, monkeypatch):
    asked, made = [], {10: ConvergenceError("too few"), 14: meshed(0.7), 20: meshed(0.9)}

    def tetrahedralize(surface, *, max_nodes, order, method):
        asked.append(max_nodes)
        if isinstance(made[max_nodes], ConvergenceError):
            raise made[max_nodes]
        return made[max_nodes]

    monkeypatch.setattr(faithful, "tetrahedralize", tetrahedralize)
    assert faithful_mesh(*box, max_nodes=10) is made[20]  # neither is good: the better one
    assert asked == [10, 14, 20]
    made[14] = meshed(1.0)
    assert faithful_mesh(*box, max_nodes=10) is made[14]
    made.update(dict.fromkeys(made, ConvergenceError("no mesh")))
    with pytest.raises(ConvergenceError, match="no mesh"):
        faithful_mesh(*box, max_nodes=10)
