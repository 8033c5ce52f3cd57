"""`reconstruct`: a tiny capture from folder to files; what cannot be reconstructed is refused in plain words."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from inference import ReconstructOptions, capture_views, reconstruct
from inference.reconstruction_command import reconstruct_command as command
from physconvex import InputError
from physconvex.convex import read_ply
from physconvex.io import Capture, load_capture, read_video, save_capture
from physconvex.reconstruction import ReconstructionConfig
from tests.reconstruction.scenes import ball_mesh, pictures, ring

CONFIG = ReconstructionConfig(levels=(0.5, 1.0), level_shares=(0.5, 0.5), refinements=1)
TINY = ReconstructOptions(budget=400, steps=12, config=CONFIG)
OPTIONS = ["--budget", "400", "--steps", "12", "--set", "levels=[0.5,1.0]", "--set", "level_shares=[0.5,0.5]"]
OPTIONS += ["--set", "refinements=1", "--no-progress"]


def write_capture(folder: Path, *, cameras: int = 5, alpha: bool = True, wall: str = "none") -> Path:
    """A still capture of the striped ball."""
    views = ring(cameras)
    for camera in views:
        frame, coverage = pictures(camera)
        if wall != "none":
            rng = np.random.default_rng(0)
            plate = np.full((48, 48, 3), 128) if wall == "plain" else rng.integers(0, 255, (48, 48, 3))
            share = coverage[..., None] / 255
            frame = (share * frame + (1 - share) * plate).round().astype(np.uint8)
        picture = np.concatenate([frame, coverage[..., None]], axis=2) if alpha else frame
        (folder / camera.name).mkdir(parents=True)
        for copy in range(2):
            Image.fromarray(picture).save(folder / camera.name / f"{copy:06d}.png")
    content = {"fps": 24.0, "frames": 2, "cameras": [camera.to_json() for camera in views]}
    (folder / "capture.json").write_text(json.dumps(content))
    ball_mesh(2).export(folder / "mesh.obj")
    return folder


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    return write_capture(tmp_path_factory.mktemp("reconstruct") / "capture")


def run(*arguments: str):
    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.slow
def test_the_command_makes_all_files_and_reads_a_finished_one_back(capture, tmp_path):
    out = tmp_path / "out"
    arguments = [str(capture), "--out", str(out), "--held-out", "view3", *OPTIONS]
    first = run(*arguments, "--json")
    assert first.exit_code == 0, first.output
    numbers = json.loads(first.stdout)
    assert numbers["start"] == "mesh" and numbers["silhouettes"] == ["alpha"]
    assert [row["camera"] for row in numbers["held_out"]["views"]] == ["view3"]
    assert len(numbers["training"]["views"]) == 4 and numbers["training"]["mean"]["psnr"] > 15
    assert numbers["config"]["budget"] == 400
    assert len(read_ply(out / "field.ply")) == numbers["convexes"] <= 400
    assert (out / "hulls.glb").stat().st_size > 1000
    assert sorted(path.name for path in (out / "views").iterdir()) == [f"view{k}.png" for k in range(5)]
    assert np.asarray(Image.open(out / "views" / "view0.png")).shape == (48, 144, 3)
    assert read_video(out / "turntable.mp4").frames.shape == (48, 448, 448, 3)
    assert not list(out.glob("*.safetensors")) and not list(out.glob(".*"))
    stamp = (out / "field.ply").stat().st_mtime_ns
    again = run(*arguments)
    assert again.exit_code == 0 and "4 views" in again.output
    assert (out / "field.ply").stat().st_mtime_ns == stamp
    other = run(*arguments, "--seed", "4")
    assert isinstance(other.exception, InputError) and "other settings" in str(other.exception)


@pytest.mark.slow
def test_flat_convexes_leave_a_body_with_volume(capture, tmp_path):
    run(str(capture), "--out", str(tmp_path / "flat"), "--set", "points_per_convex=3", *OPTIONS)
    found = reconstruct(capture, out=tmp_path / "flat", options=TINY.replace(settings=("points_per_convex=3",)))
    assert found.field.points.shape[1] == 3 and np.mean([one.psnr for one in found.training]) > 15
    assert found.body.is_watertight
    assert found.body.volume == pytest.approx(ball_mesh(2).volume, rel=0.2)  # 48 × 48 pixels, few steps
    assert (tmp_path / "flat" / "hulls.glb").stat().st_size > 1000


def test_a_run_that_was_killed_goes_on_to_the_same_field(capture, tmp_path, monkeypatch):
    monkeypatch.setattr("inference.reconstruction._STORE_EVERY", 0.0)

    def stop(progress):
        if progress.step == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(capture, out=tmp_path / "one", options=TINY, on_step=stop)
    assert (tmp_path / "one" / "state.safetensors").exists()
    steps: list[int] = []
    resumed = reconstruct(capture, out=tmp_path / "one", options=TINY, on_step=lambda p: steps.append(p.step))
    assert steps == [8, 9, 10, 11, 12]
    whole = reconstruct(capture, options=TINY)
    assert [one.psnr for one in resumed.training] == [one.psnr for one in whole.training]
    shown = whole._repr_html_()
    assert f"{len(whole.field)}, from the mesh" in shown and shown.count("data:image/png;base64,") == 1


def test_videos_with_masks_before_a_busy_wall_do_as_well(tmp_path):
    rng = np.random.default_rng(0)
    videos, masks = {}, {}
    for camera in ring(4):
        frame, coverage = pictures(camera)
        share = coverage[..., None] / 255
        mixed = (share * frame + (1 - share) * rng.integers(60, 200, (48, 48, 3))).round().astype(np.uint8)
        videos[camera.name], masks[camera.name] = np.stack([mixed] * 2), np.stack([coverage > 127] * 2)
    source = Capture(folder=tmp_path / "films", fps=24.0, frames=2, observed_frames=1, cameras=tuple(ring(4)))
    save_capture(source, videos=videos, masks=masks, mesh=ball_mesh(2), crf=8)
    result = reconstruct(tmp_path / "films", options=TINY)
    assert result.silhouettes == ("mask",)
    # Outside the mask the image is its own background, so only the object and its rim count.
    assert np.mean([one.psnr_object for one in result.training]) > 15
    assert np.mean([one.mask_iou for one in result.training]) > 0.8


def test_silhouettes_come_from_a_plain_background_where_there_is_nothing_better(tmp_path):
    folder = write_capture(tmp_path / "plain", cameras=3, alpha=False, wall="plain")
    views = capture_views(load_capture(folder))
    assert views.silhouettes == ("plain background",)
    truth = [pictures(camera)[1] > 127 for camera in ring(3)]
    for seen, mask in zip(views.training, truth, strict=True):
        both = (seen.coverage.numpy() > 0.5, mask)
        assert (both[0] & both[1]).sum() > 0.85 * (both[0] | both[1]).sum()


def test_captures_that_cannot_be_reconstructed_are_refused(capture, tmp_path):
    busy = write_capture(tmp_path / "busy", cameras=3, alpha=False, wall="busy")
    with pytest.raises(InputError, match="background is not plain"):
        reconstruct(busy, options=TINY)
    with pytest.raises(InputError, match="one view says nothing of depth"):
        reconstruct(capture, options=TINY.replace(held_out=[f"view{k}" for k in range(4)]))
    with pytest.raises(InputError, match=r"got 'side', expected one of"):
        reconstruct(capture, options=TINY.replace(held_out=["side"]))
    with pytest.raises(InputError, match="device: 'abacus' cannot be used"):
        reconstruct(capture, options=TINY.replace(device="abacus"))
    bare = tmp_path / "bare"
    shutil.copytree(capture, bare)
    (bare / "mesh.obj").unlink()
    with pytest.raises(InputError, match="the capture holds none"):
        reconstruct(bare, options=TINY.replace(start="mesh"))
    with pytest.raises(InputError, match=r"points: .* cannot be read"):
        reconstruct(bare, options=TINY.replace(points=bare / "none.ply"))
    (bare / "capture.json").write_text(json.dumps({"fps": 24.0, "frames": 2}))
    with pytest.raises(InputError, match="names no cameras"):
        reconstruct(bare, options=TINY)
    assert isinstance(run(str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")).exception, InputError)
