"""Files of every kind that users have, made here: each is read right or gives one clear line."""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from physconvex import InputError
from physconvex.io import Video, VideoError, read_image_sequence, read_video, write_video

RATE = 24.0
QUALITY = {"libx264": {"crf": "4"}, "libx265": {"crf": "4", "x265-params": "log-level=none"}}


def _moving_square(frames: int = 12, width: int = 96, height: int = 64) -> np.ndarray:
    """A red square that moves to the right over a grey ramp; top left corner bright green."""
    images = np.empty((frames, height, width, 3), np.uint8)
    images[...] = np.linspace(40, 160, width, dtype=np.uint8)[None, None, :, None]
    images[:, : height // 4, : width // 4] = (20, 220, 20)
    for k in range(frames):
        images[k, height // 2 : height // 2 + 16, 4 * k : 4 * k + 16] = (220, 30, 30)
    return images


def _encode(
    path: Path,
    images: np.ndarray,
    *,
    codec: str = "libx264",
    pixel_format: str = "yuv420p",
    rotation: int | None = None,
    times: list[int] | None = None,
    options: dict[str, str] | None = None,
    muxer_options: dict[str, str] | None = None,
) -> Path:
    """Write images with any codec; `times` are milliseconds."""
    with av.open(str(path), "w", options=muxer_options or {}) as container:
        stream = container.add_stream(codec, rate=int(RATE), options={**QUALITY.get(codec, {}), **(options or {})})
        stream.height, stream.width = images.shape[1:3]
        stream.pix_fmt = pixel_format
        if rotation is not None:
            stream.set_display_rotation(rotation)
        if times is not None:
            stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for k, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="rgba" if image.shape[-1] == 4 else "rgb24")
            if times is not None:
                frame.pts, frame.time_base = times[k], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def _close(frames: np.ndarray, expected: np.ndarray) -> None:
    """Equal but for chroma subsampling and quantisation."""
    assert frames.shape == expected.shape
    assert frames.dtype == np.uint8
    assert np.abs(frames.astype(int) - expected).mean() < 4.0


def _error(path: Path, **options: object) -> VideoError:
    with pytest.raises(VideoError) as caught:
        read_video(path, **options)  # type: ignore[arg-type]
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    assert isinstance(caught.value, InputError)
    return caught.value


# What is read


def test_plain_h264_by_both_backends_gives_the_same_bytes(tmp_path: Path) -> None:
    images = _moving_square()
    write_video(tmp_path / "clip.mp4", images, fps=RATE, crf=4)
    by_decord = read_video(tmp_path / "clip.mp4", backend="decord")
    by_pyav = read_video(tmp_path / "clip.mp4", backend="pyav")
    _close(by_pyav.frames, images)
    np.testing.assert_array_equal(by_decord.frames, by_pyav.frames)
    np.testing.assert_array_equal(by_decord.timestamps, by_pyav.timestamps)
    np.testing.assert_allclose(by_pyav.timestamps, np.arange(12) / RATE)
    assert by_decord.fps == by_pyav.fps == RATE
    assert by_pyav.alpha is None and by_pyav.warnings == ()


def test_decord_missing_falls_back_to_pyav(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_video(tmp_path / "clip.mp4", _moving_square(), fps=RATE)
    expected = read_video(tmp_path / "clip.mp4", backend="pyav")
    monkeypatch.setitem(__import__("sys").modules, "decord", None)  # makes `import decord` raise ImportError
    np.testing.assert_array_equal(read_video(tmp_path / "clip.mp4").frames, expected.frames)


@pytest.mark.parametrize(
    ("suffix", "codec", "pixel_format"),
    [
        (".mp4", "libx265", "yuv420p10le"),
        (".mp4", "libx264", "yuv422p"),
        (".mkv", "ffv1", "yuv444p12le"),
        (".mkv", "libvpx-vp9", "yuv420p"),
        (".avi", "mjpeg", "yuvj420p"),
    ],
)
def test_codecs_and_bit_depths(tmp_path: Path, suffix: str, codec: str, pixel_format: str) -> None:
    images = _moving_square()
    path = _encode(tmp_path / f"clip{suffix}", images, codec=codec, pixel_format=pixel_format)
    video = read_video(path)
    _close(video.frames, images)
    assert video.fps == pytest.approx(RATE)


@pytest.fixture
def usual_priority() -> Iterator[None]:
    """SVT-AV1's encoder, where it may, makes the thread that opens it a real-time one; reading does not."""
    if not hasattr(os, "sched_getscheduler"):
        yield
        return
    usual = os.sched_getscheduler(0), os.sched_getparam(0)
    yield
    os.sched_setscheduler(0, *usual)


def test_av1(tmp_path: Path, usual_priority: None) -> None:
    images = _moving_square()
    options = {"crf": "10", "preset": "10", "svtav1-params": "lp=1"}
    path = _encode(tmp_path / "clip.mp4", images, codec="libsvtav1", options=options)
    _close(read_video(path).frames, images)


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no scheduling classes here")
def test_writing_and_reading_leave_the_scheduling_class_alone(tmp_path: Path) -> None:
    """A real-time thread would take its core from every other process of the machine."""

    def in_real_time() -> set[int]:
        threads = map(int, os.listdir("/proc/self/task"))
        return {thread for thread in threads if os.sched_getscheduler(thread) in (os.SCHED_FIFO, os.SCHED_RR)}

    before = in_real_time()  # an encoder of another test may still be about
    write_video(tmp_path / "clip.mp4", _moving_square(), fps=RATE)
    read_video(tmp_path / "clip.mp4")
    assert in_real_time() <= before


@pytest.mark.parametrize("pixel_format", ["gray", "gray16le"])
def test_grey_becomes_rgb(tmp_path: Path, pixel_format: str) -> None:
    images = np.repeat(_moving_square()[..., :1], 3, axis=-1)
    video = read_video(_encode(tmp_path / "clip.mkv", images, codec="ffv1", pixel_format=pixel_format))
    _close(video.frames, images)
    np.testing.assert_array_equal(video.frames[..., 0], video.frames[..., 2])


@pytest.mark.parametrize("rotation", [90, 180, 270])
def test_rotation_is_applied(tmp_path: Path, rotation: int) -> None:
    images = _moving_square()
    path = _encode(tmp_path / "clip.mp4", images, rotation=rotation)
    expected = np.rot90(images, k=rotation // 90, axes=(1, 2))  # the metadata turns counter-clockwise
    _close(read_video(path).frames, expected)
    _close(read_video(path, max_side=48).frames, expected[:, ::2, ::2])


@pytest.mark.parametrize(
    ("suffix", "codec", "pixel_format"),
    [(".webm", "libvpx-vp9", "yuva420p"), (".mov", "prores_ks", "yuva444p10le"), (".mov", "qtrle", "argb")],
)
def test_alpha_is_kept(tmp_path: Path, suffix: str, codec: str, pixel_format: str) -> None:
    alpha = np.zeros((12, 64, 96, 1), np.uint8)
    alpha[:, 20:50, 30:80] = 255
    images = np.concatenate([_moving_square(), alpha], axis=-1)
    path = _encode(tmp_path / f"clip{suffix}", images, codec=codec, pixel_format=pixel_format)
    video = read_video(path)
    assert video.alpha is not None
    assert np.mean((video.alpha > 127) == (alpha[..., 0] > 127)) > 0.98
    _close(video.frames[:, 22:48, 32:78], images[:, 22:48, 32:78, :3])


def test_opaque_alpha_is_no_alpha(tmp_path: Path) -> None:
    images = np.concatenate([_moving_square(), np.full((12, 64, 96, 1), 255, np.uint8)], axis=-1)
    assert read_video(_encode(tmp_path / "clip.mov", images, codec="qtrle", pixel_format="argb")).alpha is None


def test_variable_rate_keeps_its_times(tmp_path: Path) -> None:
    times = [0, 40, 80, 180, 220, 260, 400, 440, 480, 520, 620, 660]
    path = _encode(tmp_path / "clip.mkv", _moving_square(), times=times)
    video = read_video(path)
    np.testing.assert_allclose(video.timestamps, np.array(times) / 1000, atol=1e-6)
    assert video.fps == pytest.approx(11 / 0.66)
    assert "variable frame rate" in video.warnings[0]


def test_fractional_rate(tmp_path: Path) -> None:
    write_video(tmp_path / "clip.mp4", _moving_square(), fps=30000 / 1001)
    video = read_video(tmp_path / "clip.mp4")
    assert video.fps == pytest.approx(30000 / 1001, rel=1e-9)
    np.testing.assert_allclose(video.timestamps, np.arange(12) * 1001 / 30000)


def test_non_square_pixels_become_square(tmp_path: Path) -> None:
    images = _moving_square()
    with av.open(str(tmp_path / "clip.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=int(RATE))
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    assert read_video(tmp_path / "clip.mp4").frames.shape == (12, 64, 128, 3)


def test_limits_on_length_and_size(tmp_path: Path) -> None:
    images = _moving_square(24)
    write_video(tmp_path / "clip.mp4", images, fps=RATE, crf=4)
    by_count = read_video(tmp_path / "clip.mp4", max_frames=10)
    _close(by_count.frames, images[:10])
    assert "first 10 frames" in by_count.warnings[0]
    assert len(read_video(tmp_path / "clip.mp4", max_seconds=0.5).frames) == 12
    small = read_video(tmp_path / "clip.mp4", max_side=48)
    assert small.frames.shape == (24, 32, 48, 3)
    assert small.warnings == ()


def test_many_frames_are_cut_off_without_decoding_them(tmp_path: Path) -> None:
    images = np.zeros((8000, 16, 16, 3), np.uint8)
    images[::2] = 255
    write_video(tmp_path / "long.mp4", images, fps=RATE, preset="ultrafast")
    video = read_video(tmp_path / "long.mp4")
    assert len(video.frames) == 2000
    assert "only the first 2000 frames (83.29 s)" in video.warnings[0]


# What is refused


def test_missing_file_and_dangling_link(tmp_path: Path) -> None:
    assert _error(tmp_path / "none.mp4").cause == "missing"
    (tmp_path / "link.mp4").symlink_to(tmp_path / "none.mp4")
    error = _error(tmp_path / "link.mp4")
    assert error.cause == "missing" and "symbolic link" in error.detail


def test_symbolic_link_loop(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").symlink_to(tmp_path / "b.mp4")
    (tmp_path / "b.mp4").symlink_to(tmp_path / "a.mp4")
    error = _error(tmp_path / "a.mp4")
    assert error.cause == "missing" and "leads back to itself" in error.detail


@pytest.fixture
def unreadable() -> Iterator[Path]:
    """A file that the current user may not read; root becomes nobody for the test."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        path = folder / "clip.mp4"
        path.write_bytes(b"secret")
        path.chmod(0)
        user = os.geteuid()
        if user == 0:
            os.seteuid(65534)
        try:
            yield path
        finally:
            os.seteuid(user)


@pytest.mark.skipif(os.name != "posix", reason="needs Unix permissions")
def test_unreadable_permission(unreadable: Path) -> None:
    assert _error(unreadable).cause == "permission"


def test_empty_file(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").touch()
    assert _error(tmp_path / "clip.mp4").cause == "empty_file"


def test_folder_and_pipe_are_no_video(tmp_path: Path) -> None:
    assert _error(tmp_path).cause == "not_a_video"
    os.mkfifo(tmp_path / "pipe.mp4")
    assert _error(tmp_path / "pipe.mp4").cause == "not_a_video"


@pytest.mark.parametrize("text", ["Hello, this is a text.\n" * 50, "x", "\x00" * 5000, '{"a": 1}'])
def test_other_content_named_mp4(tmp_path: Path, text: str) -> None:
    (tmp_path / "clip.mp4").write_text(text)
    assert _error(tmp_path / "clip.mp4").cause == "not_a_video"


def test_playlist_does_not_reach_other_places(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/clip.ts\n#EXT-X-ENDLIST\n")
    assert _error(tmp_path / "clip.mp4").cause in ("not_a_video", "no_video_stream", "undecodable")


def _write_audio(path: Path, codec: str) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=16000, layout="mono")
        for k in range(8):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            frame.sample_rate, frame.pts = 16000, 1024 * k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def test_audio_only(tmp_path: Path) -> None:
    _write_audio(tmp_path / "clip.mp4", "aac")
    error = _error(tmp_path / "clip.mp4")
    assert error.cause == "no_video_stream" and "audio" in error.detail


def test_subtitles_only(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_text("1\n00:00:01,000 --> 00:00:02,000\nHello\n\n" * 3)
    assert _error(tmp_path / "clip.mp4").cause in ("no_video_stream", "not_a_video")


def test_one_frame(tmp_path: Path) -> None:
    write_video(tmp_path / "clip.mp4", _moving_square(1), fps=RATE)
    assert _error(tmp_path / "clip.mp4").cause == "too_few_frames"


def test_picture_named_mp4(tmp_path: Path) -> None:
    Image.fromarray(_moving_square(1)[0]).save(tmp_path / "clip.mp4", format="PNG")
    assert _error(tmp_path / "clip.mp4").cause == "too_few_frames"


def _cut(path: Path, keep: float) -> Path:
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * keep)])
    return path


def _noise(frames: int) -> np.ndarray:
    """Frames that cannot be compressed, so that the file grows evenly."""
    return np.random.default_rng(1).integers(0, 255, (frames, 64, 96, 3), dtype=np.uint8)


def test_cut_mp4_without_index(tmp_path: Path) -> None:
    path = _encode(tmp_path / "clip.mp4", _noise(24))  # the index comes last
    assert _error(_cut(path, 0.7)).cause == "truncated"


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_cut_in_mid_stream_keeps_what_came_before(tmp_path: Path, suffix: str) -> None:
    options = {"movflags": "+faststart"} if suffix == ".mp4" else {}
    path = _encode(tmp_path / f"clip{suffix}", _noise(24), muxer_options=options, options={"bf": "0"})
    whole = read_video(path).frames
    video = read_video(_cut(path, 0.7))
    assert 8 <= len(video.frames) < 24
    np.testing.assert_array_equal(video.frames[:8], whole[:8])
    assert "cut short" in video.truncated and video.truncated in video.warnings
    says = f"{len(video.frames)} of 24 frames decoded" if suffix == ".mp4" else "of 1.00 s) decoded"
    assert says in video.truncated


def test_cut_is_told_even_where_enough_frames_come_before_it(tmp_path: Path) -> None:
    path = _encode(tmp_path / "clip.mp4", _noise(24), muxer_options={"movflags": "+faststart"}, options={"bf": "0"})
    assert read_video(path, max_frames=4).truncated == ""
    video = read_video(_cut(path, 0.7), max_frames=4)
    assert len(video.frames) == 4 and "4 of 24 frames" in video.truncated


def test_cut_after_few_frames_is_an_error(tmp_path: Path) -> None:
    path = _encode(tmp_path / "clip.mp4", _noise(24), muxer_options={"movflags": "+faststart"})
    assert _error(_cut(path, 0.2)).cause == "truncated"


def test_damaged_content(tmp_path: Path) -> None:
    path = _encode(tmp_path / "clip.mp4", _noise(24), muxer_options={"movflags": "+faststart"})
    content = bytearray(path.read_bytes())
    start = content.index(b"mdat") + 4
    content[start:] = bytes(len(content) - start)
    path.write_bytes(bytes(content))
    assert _error(path).cause in ("undecodable", "truncated")


def test_8k_frames_are_scaled_or_refused(tmp_path: Path) -> None:
    images = np.repeat(np.full((1, 4320, 7680, 3), 90, np.uint8), 3, axis=0)
    write_video(tmp_path / "clip.mp4", images, fps=RATE, preset="ultrafast")
    error = _error(tmp_path / "clip.mp4", max_bytes=64 * 2**20)
    assert error.cause == "too_large" and "max_side" in error.detail and "7680x4320" in error.detail
    assert read_video(tmp_path / "clip.mp4", max_side=256).frames.shape == (3, 144, 256, 3)


def test_bound_holds_where_the_header_does_not_tell_the_length(tmp_path: Path) -> None:
    path = _encode(tmp_path / "clip.mkv", _moving_square(24))
    assert _error(path, max_bytes=10 * 64 * 96 * 3).cause == "too_large"


@pytest.mark.parametrize("options", [{"max_side": 0}, {"max_frames": 1}, {"max_seconds": -1.0}, {"max_bytes": 0}])
def test_bad_limits(tmp_path: Path, options: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        read_video(tmp_path / "clip.mp4", **options)  # type: ignore[arg-type]


def test_error_survives_a_process_boundary(tmp_path: Path) -> None:
    error = _error(tmp_path / "none.mp4")
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.cause) == (str(error), "missing")


def test_libav_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = _encode(tmp_path / "clip.mp4", _noise(24), muxer_options={"movflags": "+faststart"})
    capfd.readouterr()
    read_video(_cut(path, 0.7))
    assert capfd.readouterr() == ("", "")


# Writing


def test_writing_is_deterministic_and_leaves_no_partial_file(tmp_path: Path) -> None:
    images = _moving_square()
    write_video(tmp_path / "a.mp4", images, fps=RATE)
    write_video(tmp_path / "b.mp4", iter(images), fps=RATE)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]


ENCODE_A_BOUNCING_DISC = """
import sys
import numpy as np
from physconvex.io import write_video
rng = np.random.default_rng(0)
y, x = np.mgrid[:112, :112] / 112
images = np.full((24, 112, 112, 3), 120.0) + 30 * np.sin(9 * x + 5 * y)[None, :, :, None]
for k in range(24):
    images[k][np.hypot(x - 0.5, y - 0.2 - 0.5 * abs(np.sin(k / 6))) < 0.15] = (200, 60, 40)
images += rng.normal(scale=2, size=images.shape)
write_video(sys.argv[1], images.clip(0, 255).astype(np.uint8), fps=24)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="MALLOC_PERTURB_ is glibc's")
def test_the_bytes_do_not_depend_on_what_lay_in_memory(tmp_path: Path) -> None:
    contents = []
    for filling in ("1", "85"):  # glibc fills fresh memory with it
        path = tmp_path / f"{filling}.mp4"
        environment = os.environ | {"MALLOC_PERTURB_": filling, "PYTHONPATH": str(Path(__file__).parents[2])}
        subprocess.run([sys.executable, "-c", ENCODE_A_BOUNCING_DISC, str(path)], env=environment, check=True)
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]


def test_failed_writing_keeps_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("old")
    images = [*_moving_square(3), np.zeros((32, 32, 3), np.uint8)]
    with pytest.raises(InputError, match="expected one size"):
        write_video(tmp_path / "a.mp4", images, fps=RATE)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]
    assert (tmp_path / "a.mp4").read_text() == "old"


@pytest.mark.parametrize(
    ("make", "fps", "match"),
    [
        (lambda: _moving_square(3, width=95), RATE, "even width"),
        (lambda: _moving_square(0), RATE, "at least one frame"),
        (lambda: _moving_square(3).astype(np.float32), RATE, "uint8"),
        (lambda: _moving_square(3), 0.0, "fps"),
        (lambda: _moving_square(3), float("nan"), "fps"),
    ],
)
def test_bad_frames_to_write(tmp_path: Path, make: Callable[[], np.ndarray], fps: float, match: str) -> None:
    with pytest.raises(InputError, match=match):
        write_video(tmp_path / "a.mp4", make(), fps=fps)
    assert not list(tmp_path.iterdir())


# Image folders


def test_image_folder(tmp_path: Path) -> None:
    images = _moving_square()
    alpha = np.zeros((12, 64, 96, 1), np.uint8)
    alpha[:, 10:30] = 200
    for k, image in enumerate(np.concatenate([images, alpha], axis=-1)):
        Image.fromarray(image).save(tmp_path / f"{k:06d}.png")
    (tmp_path / "notes.txt").write_text("ignored")
    video: Video = read_image_sequence(tmp_path, fps=30.0)
    np.testing.assert_array_equal(video.frames, images)
    np.testing.assert_array_equal(video.alpha, alpha[..., 0])
    np.testing.assert_allclose(video.timestamps, np.arange(12) / 30.0)


def test_image_folder_of_grey_jpeg_and_16_bit(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(0, 255, 96), (64, 1))
    Image.fromarray(ramp.astype(np.uint8)).save(tmp_path / "0.jpg")
    Image.fromarray((ramp * 257).astype(np.uint16)).save(tmp_path / "1.png")
    video = read_image_sequence(tmp_path, fps=30.0)
    assert video.alpha is None
    assert np.abs(video.frames[0].astype(int) - video.frames[1]).max() <= 3


def test_bad_image_folders(tmp_path: Path) -> None:
    def cause(folder: Path) -> str:
        with pytest.raises(VideoError) as caught:
            read_image_sequence(folder, fps=24.0)
        return caught.value.cause

    assert cause(tmp_path / "none") == "missing"
    assert cause(tmp_path) == "too_few_frames"
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / "0.png")
    (tmp_path / "1.png").write_text("no image")
    assert cause(tmp_path) == "undecodable"
    Image.fromarray(np.zeros((9, 8, 3), np.uint8)).save(tmp_path / "1.png")
    assert cause(tmp_path) == "undecodable"
    with pytest.raises(InputError, match="fps"):
        read_image_sequence(tmp_path, fps=0.0)


def test_numbered_images_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for name, grey in (("f_2", 20), ("f_10", 100), ("f_1", 10), ("cover", 200)):
        Image.fromarray(np.full((8, 8, 3), grey, np.uint8)).save(tmp_path / f"{name}.png")
    assert read_image_sequence(tmp_path, fps=24.0).frames[:, 0, 0, 0].tolist() == [10, 20, 100]
    for path in tmp_path.glob("f_*.png"):
        path.rename(path.with_stem(path.stem + "_x"))
    assert read_image_sequence(tmp_path, fps=24.0).frames[:, 0, 0, 0].tolist() == [200, 100, 10, 20]
