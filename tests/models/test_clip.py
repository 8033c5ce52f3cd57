"""Clips: what the network sees of a video, whatever its size, rate and length."""

import cv2
import numpy as np
import pytest

from models import MOMENT_NAMES, ClipConfig, PreparedClip, freeze_time, prepare_clip, shuffle_time, silhouette_moments
from models.clip import motion_start, resample
from physconvex import InputError

COLUMN = {name: k for k, name in enumerate(MOMENT_NAMES)}
GREY = 127


def _falling_box(
    frames: int = 24, *, width: int = 160, height: int = 120, still: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """A red box of 20 x 30 pixels that falls 3 pixels per frame after `still` frames, and its mask."""
    images = np.full((frames, height, width, 3), 200, np.uint8)
    mask = np.zeros((frames, height, width), np.uint8)
    for k in range(frames):
        top = 10 + 3 * max(0, k - still)
        mask[k, top : top + 30, 50:70] = 255
    images[mask > 0] = (200, 20, 30)
    return images, mask


def _same(a: PreparedClip, b: PreparedClip) -> None:
    for name in ("windows", "mask", "moments", "valid"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


# Time


@pytest.mark.parametrize(
    ("rate", "expected", "stride"),
    [
        (24.0, 24.0, 1),
        (25.0, 25.0, 1),
        (30.0, 30.0, 1),
        (10.0, 10.0, 1),
        (60.0, 30.0, 2),
        (48.0, 24.0, 2),
        (240.0, 24.0, 10),
        (1000.0, 1000 / 42, 42),
    ],
)
def test_constant_rate_takes_every_nth_frame(rate: float, expected: float, stride: int) -> None:
    selection = resample(np.arange(2 * round(rate)) / rate, target_fps=24.0)
    assert selection.fps == pytest.approx(expected)
    np.testing.assert_array_equal(np.diff(selection.indices), stride)


def test_varying_rate_takes_the_nearest_frames() -> None:
    generator = np.random.default_rng(0)
    times = np.cumsum(generator.uniform(0.004, 0.02, 200))
    selection = resample(times, target_fps=24.0)
    assert selection.fps == 24.0
    wanted = times[0] + np.arange(len(selection.indices)) / 24.0
    nearest = np.abs(times[None] - wanted[:, None]).argmin(axis=1)
    np.testing.assert_array_equal(selection.indices, nearest)


def test_slow_varying_rate_keeps_its_mean_rate() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 0.5, 0.6])
    assert resample(times, target_fps=24.0).fps == pytest.approx(10.0)


def test_window_starts_just_before_the_motion() -> None:
    images, mask = _falling_box(60, still=25)
    clip = prepare_clip(images, fps=24.0, mask=mask)
    assert clip.start_time == pytest.approx(23 / 24)  # the first change is between frames 25 and 26
    assert clip.valid.all() and clip.source_frames == 60
    assert "24 of 60 frames" in clip.warnings[0]


def test_without_motion_the_window_starts_at_the_beginning() -> None:
    noise = np.random.default_rng(0).normal(100, 3, (40, 64, 64, 3)).clip(0, 255).astype(np.uint8)
    assert motion_start(noise, np.arange(40), length=24) == 0


def test_motion_near_the_end_still_fills_the_window() -> None:
    images, _ = _falling_box(40, still=35)
    assert motion_start(images, np.arange(40), length=24) == 16


def test_short_clip_repeats_its_last_frame() -> None:
    images, mask = _falling_box(10)
    clip = prepare_clip(images, mask=mask)
    np.testing.assert_array_equal(clip.valid, np.arange(24) < 10)
    np.testing.assert_array_equal(clip.windows[10:], np.repeat(clip.windows[9:10], 14, axis=0))
    np.testing.assert_array_equal(clip.moments[10:], np.repeat(clip.moments[9:10], 14, axis=0))
    np.testing.assert_array_equal(clip.mask[10:], np.repeat(clip.mask[9:10], 14, axis=0))


def test_rate_of_the_source_changes_only_the_rate() -> None:
    images, mask = _falling_box()
    slow, fast = (prepare_clip(images, mask=mask, fps=fps) for fps in (24.0, 34.0))
    _same(slow, fast)
    assert (slow.fps, fast.fps) == (24.0, 34.0)


# Space


def test_shapes_types_and_greyed_background() -> None:
    images, mask = _falling_box()
    clip = prepare_clip(images, mask=mask, config=ClipConfig(image_size=64, window=48, frames=16))
    assert clip.windows.shape == (16, 48, 48, 4) and clip.windows.dtype == np.uint8
    assert clip.mask.shape == (16, 64, 64) and clip.mask.dtype == np.uint8
    assert clip.moments.shape == (16, len(MOMENT_NAMES)) and clip.moments.dtype == np.float32
    assert clip.valid.shape == (16,) and clip.valid.dtype == bool
    colours, cover = clip.windows[..., :3], clip.windows[..., 3]
    assert (colours[cover == 0] == GREY).all()
    inside = colours[cover == 255].astype(int)
    assert np.abs(inside - [200, 20, 30]).max() <= 1
    assert (clip.foreground, clip.confidence) == ("mask", 1.0)


def test_crop_is_one_square_around_the_whole_path() -> None:
    images, mask = _falling_box()
    clip = prepare_clip(images, mask=mask, config=ClipConfig(margin=0.1))
    x0, y0, side = clip.crop
    path = 30 + 3 * 23
    assert side == round(1.2 * path)
    assert abs(x0 + side / 2 - 60) <= 1 and abs(y0 + side / 2 - (10 + path / 2)) <= 1


def test_aspect_is_preserved_and_outside_is_grey() -> None:
    images, mask = _falling_box(width=80)  # the crop reaches beyond the picture's left and right
    clip = prepare_clip(images, mask=mask)
    assert clip.crop[0] < 0 or clip.crop[0] + clip.crop[2] > 80
    rows, columns = np.nonzero(clip.mask[0] > 127)
    ratio = (np.ptp(rows) + 1) / (np.ptp(columns) + 1)
    assert ratio == pytest.approx(1.5, rel=0.1)


def test_size_of_the_video_does_not_matter() -> None:
    images, mask = _falling_box()
    big = np.stack([cv2.resize(i, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST) for i in images])
    big_mask = np.stack([cv2.resize(m, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST) for m in mask])
    a, b = prepare_clip(images, mask=mask), prepare_clip(big, mask=big_mask)
    np.testing.assert_allclose(a.moments, b.moments, atol=0.03)
    assert np.abs(a.windows.astype(int) - b.windows).mean() < 3.0


def test_whole_frame_is_shown_where_nothing_is_found() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    clip = prepare_clip(np.stack([noise] * 24))
    assert (clip.foreground, clip.confidence) == ("whole_frame", 0.0)
    assert clip.crop == (0, -10, 80)
    assert any("no object was found" in warning for warning in clip.warnings)
    np.testing.assert_array_equal(clip.moments[:, COLUMN["touches_border"]], 1.0)
    assert clip.windows[0, 40, 40:60, :3].std() > 20  # the picture, not grey
    assert (clip.windows[0, 2, :, :3] == GREY).all()  # beyond it


def test_background_model_sees_what_the_mask_shows() -> None:
    images, mask = _falling_box()
    images = (images + np.random.default_rng(0).normal(0, 2, images.shape)).clip(0, 255).astype(np.uint8)
    found, given = prepare_clip(images), prepare_clip(images, mask=mask)
    assert found.foreground == "background_model"
    np.testing.assert_allclose(found.moments[:, :7], given.moments[:, :7], atol=0.12)


def test_alpha_is_used_and_a_mask_goes_before_it() -> None:
    images, mask = _falling_box()
    assert prepare_clip(images, alpha=mask).foreground == "alpha"
    _same(prepare_clip(images, alpha=mask), prepare_clip(images, mask=mask))
    assert prepare_clip(images, mask=mask, alpha=255 - mask).foreground == "mask"


# Moments


def test_moments_of_a_falling_box() -> None:
    images, mask = _falling_box()
    moments = prepare_clip(images, mask=mask).moments
    unit = 30.0  # the larger edge [px]
    fall = 3.0 * np.arange(24) / unit
    expected = {
        "centroid_x": 0 * fall, "centroid_y": -fall, "left": -10 / unit + 0 * fall, "right": 10 / unit + 0 * fall,
        "bottom": -0.5 - fall, "top": 0.5 - fall, "sqrt_area": np.sqrt(600) / unit + 0 * fall,
        "sxx": 20**2 / 12 / unit**2 + 0 * fall, "sxy": 0 * fall, "syy": 30**2 / 12 / unit**2 + 0 * fall,
        "touches_border": 0 * fall,
    }  # fmt: skip
    for name, values in expected.items():
        np.testing.assert_allclose(moments[:, COLUMN[name]], values, atol=0.02, err_msg=name)


def test_moments_resolve_a_fraction_of_a_pixel() -> None:
    """A soft mask that moves by a tenth of a pixel."""
    mask = np.zeros((2, 40, 40), np.uint8)
    mask[:, 10:20, 10:30] = 255
    mask[1, :, 10], mask[1, :, 30] = mask[1, :, 10] * 0.9, mask[1, :, 29] * 0.1
    moments = silhouette_moments(mask).moments
    for name in ("centroid_x", "left", "right"):
        assert moments[1, COLUMN[name]] - moments[0, COLUMN[name]] == pytest.approx(0.1 / 20, abs=2e-4), name
    assert moments[1, COLUMN["sqrt_area"]] == pytest.approx(moments[0, COLUMN["sqrt_area"]], abs=1e-3)


def test_sign_of_the_mixed_moment() -> None:
    mask = np.zeros((1, 40, 40), np.uint8)
    cv2.line(mask[0], (8, 32), (32, 8), 255, 3)  # rises to the right
    assert silhouette_moments(mask).moments[0, COLUMN["sxy"]] > 0.05


def test_touching_the_border_is_told() -> None:
    images, mask = _falling_box(24, height=60)
    touches = prepare_clip(images, mask=mask).moments[:, COLUMN["touches_border"]]
    np.testing.assert_array_equal(touches > 0.5, [mask[k, -1].any() for k in range(24)])
    assert 0 < touches.sum() < 24


def test_frames_without_the_object_repeat_the_one_before() -> None:
    images, mask = _falling_box()
    mask[5:8] = 0
    clip = prepare_clip(images, mask=mask)
    np.testing.assert_array_equal(clip.moments[5:8], np.repeat(clip.moments[4:5], 3, axis=0))
    assert clip.valid.all()
    assert "not seen in 3 of 24 frames" in clip.warnings[0]
    mask[:3] = 0
    clip = prepare_clip(images, mask=mask)
    np.testing.assert_array_equal(clip.moments[:3], np.repeat(clip.moments[3:4], 3, axis=0))


def test_no_object_at_all_gives_finite_moments() -> None:
    images, mask = _falling_box()
    clip = prepare_clip(images, mask=np.zeros_like(mask))
    np.testing.assert_array_equal(clip.moments, 0.0)
    assert (clip.windows[..., :3] == GREY).all() and (clip.windows[..., 3] == 0).all()


# Controls


def test_shuffled_time_moves_all_arrays_together() -> None:
    images, mask = _falling_box(20)
    clip = prepare_clip(images, mask=mask)
    shuffled = shuffle_time(clip, generator=np.random.default_rng(3))
    order = np.random.default_rng(3).permutation(24)
    assert not np.array_equal(order, np.arange(24))
    np.testing.assert_array_equal(shuffled.windows, clip.windows[order])
    np.testing.assert_array_equal(shuffled.mask, clip.mask[order])
    np.testing.assert_array_equal(shuffled.valid, clip.valid[order])
    y = COLUMN["centroid_y"]
    relative = clip.moments[order, y] - clip.moments[order[0], y]  # the origin is the new first frame
    np.testing.assert_allclose(shuffled.moments[:, y], relative, atol=0.02)
    assert shuffled.moments[0, y] == 0.0


def test_frozen_time_shows_one_frame() -> None:
    images, mask = _falling_box(20)
    clip = prepare_clip(images, mask=mask)
    frozen = freeze_time(clip, frame=7)
    np.testing.assert_array_equal(frozen.windows, np.repeat(clip.windows[7:8], 24, axis=0))
    assert frozen.valid.all()
    assert np.ptp(frozen.moments, axis=0).max() == 0.0
    np.testing.assert_array_equal(frozen.moments[:, :2], 0.0)


def test_preparing_twice_gives_the_same_bytes() -> None:
    images, _ = _falling_box()
    noisy = (images + np.random.default_rng(0).normal(0, 3, images.shape)).clip(0, 255).astype(np.uint8)
    _same(prepare_clip(noisy), prepare_clip(noisy))


# Errors


def test_bad_input_is_named() -> None:
    images, mask = _falling_box()
    with pytest.raises(InputError, match=r"frames: got float64"):
        prepare_clip(images / 255.0)
    with pytest.raises(InputError, match=r"frames: got uint8 \(24, 120, 160\)"):
        prepare_clip(images[..., 0])
    with pytest.raises(InputError, match="frames: got 1, expected at least two"):
        prepare_clip(images[:1])
    with pytest.raises(InputError, match="fps: got 0"):
        prepare_clip(images, fps=0.0)
    with pytest.raises(InputError, match="timestamps: got shape"):
        prepare_clip(images, timestamps=np.arange(5) / 24)
    with pytest.raises(InputError, match="increasing"):
        prepare_clip(images, timestamps=np.zeros(24))
    with pytest.raises(InputError, match="mask: got shape"):
        prepare_clip(images, mask=mask[:, :50])
    with pytest.raises(InputError, match="ClipConfig"):
        ClipConfig(frames=1)
