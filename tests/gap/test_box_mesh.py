"""Bodies that are boxes get regular meshes."""

import numpy as np
import pytest
import trimesh

from physconvex import InputError
from physconvex.fem import ElasticBody, NodePins, Scene, solve_static
from physconvex.gap import GapOptions, with_plane
from physconvex.gap.base.box_mesh import box_cells, box_of_body
from physconvex.io import Boundary, Capture, save_capture
from physconvex.mesh import box_mesh

CLAMP = Boundary(clamped_box=np.array([[-0.001, -1, -1], [0.001, 1, 1]]))


def held(folder, **parts):
    capture = Capture(folder, 100.0, 12, 8)
    save_capture(capture, boundary=CLAMP, **parts)
    return capture


def test_meshes_of_too_few_nodes_are_refused(tmp_path):
    with pytest.raises(InputError, match="max_nodes: got 5; expected at least 30"):
        GapOptions(max_nodes=5)
    mesh = box_of_body(held(tmp_path / "cube", mesh=trimesh.creation.box((0.1, 0.1, 0.1))), 30)
    assert len(mesh.vertices) >= 27


def test_a_beam_gets_cells_along_its_length(tmp_path):
    beam = trimesh.creation.box((0.1, 0.03, 0.03)).subdivide().subdivide()
    beam.apply_translation((0.05, 0, 0))
    mesh = box_of_body(held(tmp_path / "beam", mesh=beam), 250)
    assert len(mesh.vertices) == 15 * 5 * 5 and mesh.tets.shape[1] == 10
    assert mesh.vertices.min(0) == pytest.approx([0, -0.015, -0.015])
    assert mesh.element_volumes.sum() == pytest.approx(9e-5) and (mesh.element_volumes > 0).all()


def test_fine_tetrahedra_of_a_box_are_replaced_and_coarse_ones_kept(tmp_path):
    fine, coarse = (box_mesh((0.1, 0.03, 0.03), cells, order=1) for cells in ((20, 6, 6), (8, 1, 1)))
    assert len(box_of_body(held(tmp_path / "fine", tets=fine), 250).vertices) == 375
    assert box_of_body(held(tmp_path / "coarse", tets=coarse), 250) is None


def test_other_shapes_are_left(tmp_path):
    assert box_of_body(held(tmp_path / "ball", mesh=trimesh.creation.icosphere(radius=0.1)), 250) is None
    rod = trimesh.creation.cylinder(0.05, 0.2)
    assert box_of_body(held(tmp_path / "rod", mesh=rod), 250) is None


def test_a_cube_is_cut_evenly_held_or_not(tmp_path):
    free = Capture(tmp_path / "free", 100.0, 12, 8)
    save_capture(free, mesh=trimesh.creation.box((0.1, 0.1, 0.1)))
    mesh = box_of_body(free, 250)
    assert len(mesh.vertices) == 5**3 and np.ptp(mesh.vertices, axis=0) == pytest.approx(0.1)
    assert box_cells(np.array([0.1, 0.1, 0.1]), 250) == (2, 2, 2)
    assert box_cells(np.array([0.03, 0.03, 0.1]), 250) == (1, 1, 8)
    assert box_cells(np.array([0.03, 0.03, 0.1]), 250, across=2) == (2, 2, 6)


def test_a_bar_with_a_stiff_core_sags_and_does_not_swerve(tmp_path):
    beam = trimesh.creation.box((0.1, 0.03, 0.03)).apply_translation((0.05, 0, 0))
    mesh = box_of_body(held(tmp_path / "beam", mesh=beam), 250)

    def sag(decades):
        body = ElasticBody(mesh, youngs_modulus=1e5, poisson_ratio=0.3, density=1000.0)
        x = body.quadrature_points[..., 1:] / 0.015
        factor = 10 ** (decades * (1 - (x**2).sum(-1)))
        uneven = ElasticBody(mesh, youngs_modulus=1e5 * factor, poisson_ratio=0.3, density=1000.0)
        pins = NodePins(np.flatnonzero(mesh.vertices[:, 0] < 1e-3))
        moved = solve_static(Scene(body=uneven, node_pins=pins)) - mesh.vertices
        return moved[mesh.vertices[:, 0] > 0.1 - 1e-9].mean(0)

    change = sag(0.3) - sag(0.0)
    assert abs(change[1]) < 0.02 * abs(change[2])  # .8 of it on one cell across whose diagonals all run one way


@pytest.mark.parametrize(("box", "axis", "plane"), [
    ([[-1, -1, -1], [0.012, 1, 1]], 0, 0.012),
    ([[-1, -1, -1], [1, 1, 0.01]], 2, 0.01),
    ([[-1, 0.005, -1], [1, 1, 1]], 1, 0.005),
])  # fmt: skip
def test_what_is_held_ends_at_a_plane_of_nodes(tmp_path, box, axis, plane):
    beam = trimesh.creation.box((0.1, 0.03, 0.03)).apply_translation((0.05, 0, 0))
    capture = Capture(tmp_path / "c", 100.0, 12, 8)
    save_capture(capture, mesh=beam, boundary=Boundary(clamped_box=np.array(box, dtype=float)))
    mesh = box_of_body(capture, 250)
    x = mesh.vertices[:, axis]
    assert np.isclose(x, plane).sum() >= 9 and (mesh.element_volumes > 0).all()
    assert mesh.volume == pytest.approx(9e-5) and np.ptp(mesh.vertices, axis=0) == pytest.approx([0.1, 0.03, 0.03])


def test_a_box_that_holds_all_or_the_middle_makes_no_plane(tmp_path):
    beam = trimesh.creation.box((0.1, 0.03, 0.03)).apply_translation((0.05, 0, 0))
    for name, box in {"middle": [[0.04, -1, -1], [0.06, 1, 1]], "all": [[-1, -1, -1], [1, 1, 1]]}.items():
        capture = Capture(tmp_path / name, 100.0, 12, 8)
        save_capture(capture, mesh=beam, boundary=Boundary(clamped_box=np.array(box, dtype=float)))
        assert len(box_of_body(capture, 250).vertices) == 153


def test_a_held_bar_is_as_stiff_on_few_cells_as_on_many():
    """The same sag under the body's weight, to 3 %; with nodes at x = 0 alone held it is 14 % larger."""
    tips = []
    for cells in ((8, 1, 1), (24, 4, 4)):
        mesh = with_plane(np.zeros(3), np.array([1.0, 0.25, 0.25]), cells, 0, 0.04)
        body = ElasticBody(mesh, youngs_modulus=1e6, poisson_ratio=0.3, density=1000.0)
        held = np.flatnonzero(mesh.vertices[:, 0] <= 0.04 + 1e-9)
        found = solve_static(Scene(body, node_pins=NodePins(held)))
        tips.append(float((found - mesh.vertices)[mesh.vertices[:, 0] > 1 - 1e-9, 2].mean()))
    assert tips[0] == pytest.approx(tips[1], rel=0.03)
