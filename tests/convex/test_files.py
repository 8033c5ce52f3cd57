"""PLY and GLB files of convex fields."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from physconvex import InputError
from physconvex.convex import ConvexField, coefficients_of_colour, hull_mesh, read_ply, write_glb, write_ply
from tests.convex.fields import cube, random_field


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("points", "degree"), [(4, 0), (6, 3), (12, 1)])
def test_ply_gives_back_every_bit(tmp_path: Path, dtype: torch.dtype, points: int, degree: int) -> None:
    field = random_field(7, points=points, degree=degree, dtype=dtype)
    write_ply(field, tmp_path / "field.ply")
    for back, value in zip(read_ply(tmp_path / "field.ply").tensors(), field.tensors(), strict=True):
        assert torch.equal(back, value) and back.dtype == dtype


def test_empty_field_round_trip(tmp_path: Path) -> None:
    write_ply(random_field(3).select(torch.zeros(3, dtype=torch.bool)), tmp_path / "empty.ply")
    assert len(read_ply(tmp_path / "empty.ply")) == 0


def test_damaged_and_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "field.ply"
    with pytest.raises(InputError, match="cannot be read"):
        read_ply(path)
    write_ply(random_field(2), path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="damaged"):
        read_ply(path)
    trimesh.creation.box().export(path)
    with pytest.raises(InputError, match="no convex field"):
        read_ply(path)
    path.write_bytes(b"solid")
    with pytest.raises(InputError, match="expected a binary"):
        read_ply(path)
    with pytest.raises(InputError, match=r"\.to\(\)"):
        write_ply(random_field(1, dtype=torch.float16), path)


def test_values_out_of_range_are_refused(tmp_path: Path) -> None:
    field = random_field(2)
    write_ply(field.map(lambda tensor: -tensor), tmp_path / "negative.ply")
    with pytest.raises(InputError, match="smoothness"):
        read_ply(tmp_path / "negative.ply")


def _areas(triangles: ConvexField) -> torch.Tensor:
    a, b, c = triangles.points.unbind(dim=1)
    return 0.5 * torch.linalg.cross(b - a, c - a).norm(dim=1)


def test_glb_holds_the_hulls_in_their_colours(tmp_path: Path) -> None:
    box = cube(0.5)
    red = box.map(torch.clone)
    red.harmonics[:] = coefficients_of_colour(torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64), degree=0)
    write_glb(red, tmp_path / "hulls.glb")
    mesh = trimesh.load(tmp_path / "hulls.glb", force="mesh")
    assert mesh.is_watertight and np.isclose(mesh.volume, 1.0, rtol=1e-6)
    assert (mesh.visual.vertex_colors == [255, 0, 0, round(0.9 * 255)]).all()
    field = random_field(3)
    alone = [hull_mesh(field.select(torch.tensor([convex]))).volume for convex in range(3)]
    assert np.isclose(hull_mesh(field).volume, sum(alone))
    flat = box.with_points(box.points * torch.tensor([1.0, 1.0, 0.0]))
    triangles = random_field(2, points=3)
    for sheet, area in ((flat, 2.0), (triangles, 2 * float(_areas(triangles).sum()))):
        assert hull_mesh(sheet).area == pytest.approx(area, rel=1e-6)  # both sides
    with pytest.raises(InputError, match="face"):
        write_glb(box.with_points(box.points * 0), tmp_path / "flat.glb")
