"""Fields in the browser."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from physconvex import InputError
from physconvex.convex import ConvexField, coefficients_of_colour, write_ply
from physconvex.io import look_at
from physconvex.render import FieldViewer, render
from physconvex.render.viewer import draw_view, read_fields
from tests.convex.browser import screenshots
from tests.convex.fields import random_field

PAINT = (0.85, 0.2, 0.1)


def painted() -> ConvexField:
    """A red octahedron about the origin."""
    ones = torch.ones(1)
    points = torch.cat([torch.eye(3), -torch.eye(3)])[None] * 0.5
    return ConvexField(points, 200 * ones, ones, 0.98 * ones, coefficients_of_colour(torch.tensor([PAINT])))


def test_pictures_are_those_of_the_rasteriser() -> None:
    field = random_field(6, dtype=torch.float32)
    camera = look_at((0.3, -3.0, 0.8), (0, 0, 0), width=60, height=40, vertical_field_of_view=0.7)
    axes = np.array(camera.transform_matrix)[:3, :3] * [1, -1, -1]  # right, down, forward
    wxyz = np.roll(Rotation.from_matrix(axes).as_quat(), 1)
    picture = draw_view(field, position=camera.position, wxyz=wxyz, field_of_view=0.7, width=60, height=40)
    expected = 255 * render(field, camera).colour.clamp(0, 1).numpy()
    assert expected.std() > 5
    assert np.abs(picture - expected).max() < 2


def test_files_and_folders_are_read_in_order(tmp_path: Path) -> None:
    for k in (2, 0, 1):
        write_ply(random_field(k + 1, dtype=torch.float32), tmp_path / f"frame{k}.ply")
    assert [(name, len(field)) for name, field in read_fields(tmp_path)] == [
        ("frame0", 1),
        ("frame1", 2),
        ("frame2", 3),
    ]
    write_ply(painted(), tmp_path / "field.ply")
    assert [name for name, _ in read_fields(tmp_path)] == ["field"]
    with pytest.raises(InputError, match="does not exist"):
        read_fields(tmp_path / "none.ply")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no \.ply file"):
        read_fields(tmp_path / "empty")


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(InputError, match=r"pip install 'physconvex\[viewer\]'"):
        FieldViewer([("field", painted())])


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")
def test_a_browser_shows_the_field(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    viewer = FieldViewer([("field", painted())], port=8431, size=400)
    share = 0.0
    try:
        for picture in screenshots(viewer.address, tmp_path / "profile", 120):
            near = np.abs(picture.astype(int) - 255 * np.array(PAINT)).max(axis=-1) < 12
            share = max(share, float(near.mean()))
            if share > 0.05:
                break
    finally:
        viewer.close()
    assert share > 0.05  # a good part of the window is the octahedron, seen in its colour
