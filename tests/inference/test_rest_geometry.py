"""Captures without a rest geometry: the body is reconstructed from the first frames, or given."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from inference import ReconstructOptions, with_rest_geometry
from physconvex import InputError
from physconvex.io import load_capture
from physconvex.reconstruction import ReconstructionConfig
from tests.reconstruction.scenes import RADIUS, pictures, ring, speckled_ball

QUICK = ReconstructOptions(
    budget=400, steps=12, config=ReconstructionConfig(levels=(0.5, 1.0), level_shares=(0.5, 0.5), refinements=1)
)


@pytest.fixture(scope="module")
def bare(tmp_path_factory) -> Path:
    """Pictures of frame 0 alone, from eight sides, without any mesh."""
    folder = tmp_path_factory.mktemp("bare") / "capture"
    folder.mkdir()
    views, ball = ring(8, size=96), speckled_ball()
    for camera in views:
        frame, coverage = pictures(camera, ball)
        Image.fromarray(frame).save(folder / f"{camera.name}.png")
        Image.fromarray(coverage).save(folder / f"{camera.name}_mask.png")
    content = {"fps": 24.0, "frames": 2, "cameras": [camera.to_json() for camera in views]}
    (folder / "capture.json").write_text(json.dumps(content))
    return folder


@pytest.mark.slow
def test_pictures_of_frame_0_give_a_closed_body_once(bare, tmp_path):
    stages: list[tuple[str, bool]] = []
    for _ in range(2):
        found = with_rest_geometry(
            load_capture(bare), out=tmp_path, options=QUICK, on_stage=lambda *stage: stages.append(stage)
        )
        body = found.mesh()
        assert body is not None and body.is_watertight
        assert body.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.05)
    assert stages == [("reconstruction", False), ("reconstruction", True)]
    assert found.object_size == pytest.approx(2 * RADIUS, rel=0.05)
    written = trimesh.load(tmp_path / "reconstruction" / "body.glb", force="mesh", process=False)
    assert written.extents == pytest.approx(body.extents[[0, 2, 1]], rel=1e-3)


def test_a_given_body_takes_the_place_of_the_mesh(bare, tmp_path):
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.export(tmp_path / "box.ply")
    found = with_rest_geometry(load_capture(bare), body=tmp_path / "box.ply")
    assert found.object_size == pytest.approx(0.3) and found.tets() is None
    box.faces[0] = box.faces[0][::-1]
    box.export(tmp_path / "open.ply")
    with pytest.raises(InputError, match="not a closed"):
        with_rest_geometry(load_capture(bare), body=tmp_path / "open.ply")
    with pytest.raises(InputError, match="not a readable mesh"):
        with_rest_geometry(load_capture(bare), body=tmp_path / "none.ply")


def test_one_camera_and_no_geometry_is_refused_with_what_is_missing(bare, tmp_path):
    alone = shutil.copytree(bare, tmp_path / "alone")
    content = json.loads((alone / "capture.json").read_text())
    content["cameras"] = content["cameras"][:1]
    (alone / "capture.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"no rest geometry, and 1 camera.*frame 0 from more sides"):
        with_rest_geometry(load_capture(alone))
    content["cameras"] = json.loads((bare / "capture.json").read_text())["cameras"][:2]
    (alone / "capture.json").write_text(json.dumps(content))
    Image.fromarray(np.zeros((96, 96), np.uint8)).save(alone / "view1_mask.png")
    with pytest.raises(InputError, match="silhouette is empty"):
        with_rest_geometry(load_capture(alone), options=QUICK)
