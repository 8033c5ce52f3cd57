"""Captures without a rest geometry: the body is reconstructed from the first frames, or given."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from PIL import Image
from typer import Typer
from typer.testing import CliRunner

from inference import ReconstructOptions, reconstruct, rest_geometry, with_rest_geometry
from inference.diagnosis_command import diagnose_command
from inference.simulation_command import simulate_command
from physconvex import InputError
from physconvex.convex import ConvexField, read_ply
from physconvex.io import Camera, load_capture
from physconvex.reconstruction import ReconstructionConfig
from tests.reconstruction.scenes import RADIUS, WALL, cup, painted, pictures, ring, speckled_ball

QUICK = ReconstructOptions(
    budget=400, steps=12, config=ReconstructionConfig(levels=(0.5, 1.0), level_shares=(0.5, 0.5), refinements=1)
)


@pytest.fixture(scope="module")
def bare(tmp_path_factory) -> Path:
    """Pictures of frame 0 alone, from eight sides, without any mesh."""
    return written(tmp_path_factory.mktemp("bare") / "capture", ring(8, size=96), speckled_ball())


def written(folder: Path, views: list[Camera], field: ConvexField) -> Path:
    """A capture of pictures of a field alone."""
    folder.mkdir()
    for camera in views:
        frame, coverage = pictures(camera, field)
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
    record = json.loads((tmp_path / "reconstruction" / "reconstruction.json").read_text())
    assert record["warnings"] == [] and record["body"]["views"] == 8 and record["body"]["unseen"] < 0.1
    assert stages == [("reconstruction", False), ("reconstruction", True)]
    assert found.object_size == body.extents.max()
    assert body.extents[:2] == pytest.approx(2 * RADIUS, rel=0.02)
    assert 1.0 < body.extents[2] / (2 * RADIUS) < 1.11  # cameras 34° above and below leave cones at the poles
    written = trimesh.load(tmp_path / "reconstruction" / "body.glb", force="mesh", process=False)
    assert written.extents == pytest.approx(body.extents[[0, 2, 1]], rel=1e-3)
    assert min(written.visual.material.baseColorTexture.size) >= 1024


@dataclass(frozen=True)
class _Verdict:
    sentence: str
    caveats: tuple[str, ...]


@dataclass(frozen=True)
class _Report:
    """Of a diagnosis, as far as the command needs it."""

    verdict: _Verdict
    how_far: tuple[SimpleNamespace, ...]

    def save(self, folder: Path) -> None:
        (folder / "caveats.txt").write_text("\n".join(self.verdict.caveats))


@pytest.mark.slow
def test_a_diagnosis_tells_the_error_of_the_body_from_pictures(tmp_path, monkeypatch, caplog):
    few = written(tmp_path / "few", ring(8, size=96)[:5], speckled_ball())
    diagnosed = []

    def diagnose(source, *, second_take, **how):
        diagnosed.extend((source, second_take))
        gap = SimpleNamespace(data="the rest", gap_before=0.1, gap_after=0.1, noise_floor=0.1)
        return _Report(_Verdict("No effect.", ("A limit.",)), (gap,))

    monkeypatch.setattr("physconvex.gap.diagnose", diagnose)
    monkeypatch.setattr(
        rest_geometry, "reconstruct", lambda capture, *, out, options: reconstruct(capture, out=out, options=QUICK)
    )
    app = Typer()
    app.command()(diagnose_command)
    for _ in range(2):  # at last the bodies are read from disk
        caplog.clear()
        arguments = [str(few), "--second-take", str(few), "--out", str(tmp_path), "--no-progress"]
        ended = CliRunner().invoke(app, arguments, catch_exceptions=False)
        assert ended.exit_code == 0 and re.search(r"Its surface is [\d.]+ mm off \(rms\)", ended.stdout)
        first, unseen, off = (tmp_path / "caveats.txt").read_text().splitlines()
        assert first == "A limit." and "no camera sees" in unseen and "which no interval" in off
        assert [unseen in record.getMessage() for record in caplog.records] == [True, True]
    assert len(diagnosed) == 4 and all(capture.mesh().is_watertight for capture in diagnosed)
    assert (tmp_path / "second_take" / "reconstruction" / "body.ply").is_file()


@pytest.mark.slow
def test_a_cup_is_hollow_and_its_wall_is_told(tmp_path):
    found = reconstruct(written(tmp_path / "cup", ring(12, size=128), painted(cup())), options=QUICK)
    assert found.body is not None and found.body.is_watertight
    assert found.body.volume == pytest.approx(cup().volume, rel=0.25)
    (told,) = [warning for warning in found.warnings if "hollow" in warning]
    share, wall = re.search(r"hollow of (\d+) % .* wall is (\d+) mm thick", told).groups()
    assert 35 < int(share) < 65 and int(wall) == pytest.approx(1000 * WALL, abs=3)


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
    with pytest.raises(
        InputError, match=r"no rest geometry, and 1 camera.*frame 0 from more sides.*no camera sees"
    ) as told:
        with_rest_geometry(load_capture(alone))
    assert "from azimuth 55° to 305° or from below" in str(told.value)  # the one is at 0°, 34° above the horizon
    with pytest.raises(InputError, match=r"1 view\(s\) to fit.*from azimuth 55° to 305°"):
        reconstruct(alone)
    content["cameras"] = json.loads((bare / "capture.json").read_text())["cameras"][:2]
    (alone / "capture.json").write_text(json.dumps(content))
    Image.fromarray(np.zeros((96, 96), np.uint8)).save(alone / "view1_mask.png")
    with pytest.raises(InputError, match="silhouette is empty"):
        with_rest_geometry(load_capture(alone), options=QUICK)


def simulated(*arguments: str):
    app = Typer()
    app.command()(simulate_command)
    fast = ("basis.max_nodes=200", "basis.modes=2", "time.frames=3", "time.steps_per_frame=4", "basis.mesher=lattice")
    return CliRunner().invoke(app, [*arguments, "--json", *(part for one in fast for part in ("--set", one))])


def test_a_capture_moves_as_its_own_surface_or_a_given_one(bare, tmp_path):
    dense = shutil.copytree(bare, tmp_path / "dense")
    content = json.loads((dense / "capture.json").read_text()) | {"density": 500.0}
    (dense / "capture.json").write_text(json.dumps(content))
    trimesh.creation.box((0.2, 0.2, 0.3)).export(tmp_path / "box.ply")
    result = simulated(str(dense), "--body", str(tmp_path / "box.ply"), "--out", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["mass_kg"] == pytest.approx(500 * 0.2 * 0.2 * 0.3, rel=0.01)
    shutil.copy(tmp_path / "box.ply", dense / "mesh.ply")
    result = simulated(str(dense), "--out", str(tmp_path / "out"), "--size", "0.6")
    assert json.loads(result.stdout)["mass_kg"] == pytest.approx(500 * 0.4 * 0.4 * 0.6, rel=0.01)
    assert not (tmp_path / "out" / "reconstruction").exists()
    both = simulated(str(dense), str(dense), "--body", str(tmp_path / "box.ply"))
    assert isinstance(both.exception, InputError) and "expected one" in str(both.exception)


@pytest.mark.slow
def test_a_bare_capture_is_reconstructed_once_and_simulated_with_its_field(bare, tmp_path, monkeypatch):
    out = tmp_path / "played"
    monkeypatch.setattr(
        rest_geometry, "reconstruct", lambda capture, out, options: reconstruct(capture, out=out, options=QUICK)
    )
    for _ in range(2):
        result = simulated(str(bare), "--out", str(out))
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)["mass_kg"] == pytest.approx(1000 * 4 / 3 * np.pi * RADIUS**3, rel=0.05)
    assert "reconstruction (read again)" in result.stderr
    fields = sorted((out / "convexes").iterdir())
    first, last = (read_ply(fields[k]).centres.mean(dim=0)[2].item() for k in (0, -1))
    assert len(fields) == 3 and first - last == pytest.approx(9.81 / 2 * (2 / 24) ** 2, rel=0.05)


@pytest.mark.slow
def test_sides_that_no_camera_sees_and_a_cut_picture_are_told(bare, tmp_path):
    """The four cameras above the horizon, one of which shows a part alone."""
    upper = shutil.copytree(bare, tmp_path / "upper")
    content = json.loads((upper / "capture.json").read_text())
    content["cameras"] = content["cameras"][::2]
    for name in ("view2.png", "view2_mask.png"):
        picture = np.asarray(Image.open(upper / name))
        Image.fromarray(picture[:48]).save(upper / name)
    content["cameras"][1]["h"] = 48
    (upper / "capture.json").write_text(json.dumps(content))
    found = reconstruct(upper, options=QUICK)
    cut, unseen = found.warnings
    assert "view2: the object leaves the picture in frame 0" in cut
    assert "do not tell its place: no camera sees the body from below" in unseen
    assert found.to_json()["warnings"] == [cut, unseen]
