"""Bodies that are boxes get regular meshes."""

import numpy as np
import pytest
import trimesh

from physconvex.capture import Boundary, Capture, save_capture
from physconvex.fem import box_mesh
from physconvex.gap.boxes import box_cells, box_of_body

CLAMP = Boundary(clamped_box=np.array([[-0.001, -1, -1], [0.001, 1, 1]]))


def held(folder, **parts):
    capture = Capture(folder, 100.0, 12, 8)
    save_capture(capture, boundary=CLAMP, **parts)
    return capture


def test_a_beam_gets_cells_along_its_length(tmp_path):
    beam = trimesh.creation.box((0.1, 0.03, 0.03)).subdivide().subdivide()
    beam.apply_translation((0.05, 0, 0))
    mesh = box_of_body(held(tmp_path / "beam", mesh=beam), 250)
    assert len(mesh.vertices) == 17 * 3 * 3 and mesh.tets.shape[1] == 10
    assert mesh.vertices.min(0) == pytest.approx([0, -0.015, -0.015])
    assert mesh.element_volumes.sum() == pytest.approx(9e-5) and (mesh.element_volumes > 0).all()


def test_fine_tetrahedra_of_a_box_are_replaced_and_coarse_ones_kept(tmp_path):
    fine, coarse = (box_mesh((0.1, 0.03, 0.03), cells, order=1) for cells in ((20, 6, 6), (8, 1, 1)))
    assert len(box_of_body(held(tmp_path / "fine", tets=fine), 250).vertices) == 153
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
