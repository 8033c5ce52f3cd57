"""Every way in which a file can be bad gives one clear line, and the batch goes on."""

import csv
import os
import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from inference import ClipSource, load_clip, predict, predict_batch
from physconvex import InputError
from physconvex.io import write_video
from tests.inference.conftest import MakeClip, falling_ball
from tests.inference.predictor_double import PredictorDouble


def write_audio(path: Path) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        for k in range(10):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            frame.sample_rate, frame.pts = 8000, k * 1024
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def write_frames(
    path: Path,
    images: np.ndarray,
    *,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    times: list[int] | None = None,
) -> None:
    """Encode frames with any codec and pixel format; `times` in units of 1/240 s make the rate vary."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=24)
        stream.height, stream.width = images.shape[1:3]
        stream.pix_fmt = pixels
        if times is not None:
            stream.codec_context.time_base = Fraction(1, 240)
        for k, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=pixels)
            if times is not None:
                frame.pts, frame.time_base = times[k], Fraction(1, 240)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def noise() -> np.ndarray:
    """Frames of the size of a falling ball that cannot be compressed, so that the file grows evenly."""
    return np.random.default_rng(0).integers(0, 255, falling_ball().shape, dtype=np.uint8)


@pytest.fixture(scope="module")
def bad_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of each bad kind and one good clip."""
    folder = tmp_path_factory.mktemp("bad")
    write_frames(folder / "good.mp4", falling_ball())
    (folder / "empty.mp4").touch()
    whole = (folder / "good.mp4").read_bytes()
    (folder / "truncated.mp4").write_bytes(whole[: len(whole) // 2])
    write_video(folder / "few.mp4", noise(), fps=24.0)  # its index comes first, so that frames can be read
    content = (folder / "few.mp4").read_bytes()
    (folder / "few.mp4").write_bytes(content[: int(len(content) * 0.4)])
    (folder / "text.mp4").write_text("this is no video\n" * 40)
    write_audio(folder / "audio.mp4")
    write_frames(folder / "one.mp4", falling_ball(frames=1))
    (folder / "loop.mp4").symlink_to("loop.mp4")
    (folder / "up").symlink_to(folder)
    (folder / "capture").mkdir()
    (folder / "capture" / "capture.json").write_text("{not json")
    return folder


def test_each_bad_file_gets_one_line_and_the_good_one_its_prediction(bad_folder: Path, tmp_path: Path) -> None:
    summary = predict_batch(bad_folder, out=tmp_path, predictor=PredictorDouble(), processes=False)
    with open(tmp_path / "predictions.csv", newline="", encoding="utf-8") as file:
        errors = {Path(row["path"]).name: row["error"] for row in csv.DictReader(file)}
    assert errors.pop("good.mp4") == ""
    says = {
        "empty.mp4": "empty",
        "truncated.mp4": "truncated",
        "few.mp4": "whole frames, at least 8 needed; copy it again [truncated]",
        "text.mp4": "not a video",
        "audio.mp4": "no video stream",
        "one.mp4": "1 frame",
        "loop.mp4": "loop",
        "up": "loop",
        "capture": "not valid JSON",
    }
    assert set(errors) == set(says)
    for name, part in says.items():
        assert part in errors[name], errors[name]
        assert str(bad_folder / name) in errors[name] and "\n" not in errors[name]
        assert "Traceback" not in errors[name] and "unexpected" not in errors[name]
    assert (summary.predicted, summary.failed, summary.exit_code) == (1, 9, 1)


def test_a_mask_cut_short_is_named(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", falling_ball(), fps=24.0)
    write_video(tmp_path / "a_mask.mp4", noise(), fps=24.0)
    content = (tmp_path / "a_mask.mp4").read_bytes()
    (tmp_path / "a_mask.mp4").write_bytes(content[: int(len(content) * 0.9)])
    with pytest.raises(InputError, match=r"a_mask\.mp4: the file is cut short.* of 12 frames decoded"):
        predict(tmp_path / "a.mp4", predictor=PredictorDouble())


@pytest.mark.parametrize(
    "name", ["empty.mp4", "truncated.mp4", "few.mp4", "text.mp4", "audio.mp4", "one.mp4", "loop.mp4"]
)
def test_predict_raises_the_same(bad_folder: Path, name: str) -> None:
    with pytest.raises(InputError) as caught:
        predict(bad_folder / name, predictor=PredictorDouble())
    assert str(bad_folder / name) in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_files_and_folders_without_permission(tmp_path: Path, make_clip: MakeClip) -> None:
    make_clip(tmp_path / "clips" / "good.mp4")
    locked = make_clip(tmp_path / "clips" / "locked.mp4")
    (tmp_path / "clips" / "closed").mkdir()
    locked.chmod(0)
    (tmp_path / "clips" / "closed").chmod(0)
    summary = predict_batch(tmp_path / "clips", out=tmp_path / "out", predictor=PredictorDouble())
    (tmp_path / "clips" / "closed").chmod(0o700)
    errors = {Path(row.path).name: row.error for row in summary.rows if row.error}
    assert set(errors) == {"locked.mp4", "closed"}
    assert all("permission" in error for error in errors.values())


def test_a_folder_that_may_not_be_listed_is_reported(
    tmp_path: Path, make_clip: MakeClip, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_clip(tmp_path / "clips" / "good.mp4")
    (tmp_path / "clips" / "closed").mkdir()
    scandir = os.scandir

    def refuse(path: str | os.PathLike[str]) -> object:
        if Path(path).name == "closed":
            raise PermissionError(13, "Permission denied")
        return scandir(path)

    monkeypatch.setattr("inference.sources.os.scandir", refuse)
    summary = predict_batch(tmp_path / "clips", out=tmp_path / "out", predictor=PredictorDouble())
    (row,) = [row for row in summary.rows if row.error]
    assert row.path.endswith("closed") and "permission" in row.error and summary.predicted == 1


@pytest.mark.parametrize(
    ("codec", "pixels"),
    [("libx264", "yuv420p10le"), ("libx264", "gray"), ("libx265", "yuv420p"), ("mpeg4", "yuv420p")],
)
def test_unusual_pixels_and_codecs_are_read(tmp_path: Path, codec: str, pixels: str) -> None:
    write_frames(tmp_path / "a.mp4", falling_ball(), codec=codec, pixels=pixels)
    prediction = predict(tmp_path / "a.mp4", predictor=PredictorDouble())
    assert prediction.frames_used == 12 and prediction.foreground == "background_model"


def test_variable_frame_rate_is_resampled_and_said(tmp_path: Path) -> None:
    times = [0, 10, 20, 30, 60, 70, 80, 120, 130, 140, 150, 160]
    write_frames(tmp_path / "a.mp4", falling_ball(), times=times)
    prediction = predict(tmp_path / "a.mp4", predictor=PredictorDouble())
    assert any("variable frame rate" in warning for warning in prediction.warnings)
    assert prediction.fps == pytest.approx(11 / (160 / 240), rel=0.02)


@pytest.mark.slow
def test_8k_frames_are_scaled_down_while_reading(tmp_path: Path) -> None:
    small = falling_ball(frames=4, width=96, height=54)
    write_frames(tmp_path / "a.mp4", small.repeat(80, axis=1).repeat(80, axis=2), codec="mpeg4")
    prediction = predict(tmp_path / "a.mp4", predictor=PredictorDouble())
    assert prediction.frames_used == 4


def test_rotation_metadata_is_applied(tmp_path: Path) -> None:
    upright, turned = tmp_path / "upright.mp4", tmp_path / "turned.mp4"
    write_frames(upright, falling_ball(width=48, height=96))
    write_frames(turned, np.rot90(falling_ball(width=48, height=96), axes=(1, 2)))
    data = bytearray(turned.read_bytes())
    at = data.index(b"tkhd") + 44  # the 3x3 matrix of the track header (ISO/IEC 14496-12, 8.3.2), version 0
    data[at : at + 36] = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    turned.write_bytes(data)
    frames = [load_clip(ClipSource(path, "video", path.stem)).frames for path in (upright, turned)]
    assert frames[1].shape == frames[0].shape == (12, 96, 48, 3)
    ball = frames[0][..., 0] < 90
    assert frames[1][ball].mean() == pytest.approx(frames[0][ball].mean(), abs=4), "the ball is where it was"
