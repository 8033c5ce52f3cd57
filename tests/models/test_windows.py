"""Windows that follow the object, and what the network over them reads."""

import numpy as np
import pytest
import torch

from models import GREY
from models.encoder import normalised
from models.network import FrameNetwork
from models.windows import object_windows


def disc(x: float, y: float, radius: float, *, side: int = 96, frames: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A disc about (x, y), red on its left half and blue on its right, as a clip that stands still."""
    places = np.arange(side) + 0.5
    mask = (255 * np.clip(radius - np.hypot(places[None] - x, places[:, None] - y) + 0.5, 0, 1)).astype(np.uint8)
    image = np.full((side, side, 3), GREY, np.uint8)
    inside, left = mask > 0, np.broadcast_to(places < x, (side, side))
    image[inside & left], image[inside & ~left] = (220, 30, 30), (30, 30, 220)
    return np.repeat(image[None], frames, axis=0), np.repeat(mask[None], frames, axis=0)


def joined(*clips: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    frames, mask = (np.concatenate(parts) for parts in zip(*clips, strict=True))
    return frames, mask


def test_windows_show_the_same_wherever_the_object_is() -> None:
    here = object_windows(*disc(40.0, 30.0, 12.0), size=32, extent=1.6)
    there = object_windows(*disc(61.0, 55.0, 12.0), size=32, extent=1.6)
    assert here.shape == (3, 32, 32, 4) and here.dtype == np.uint8
    np.testing.assert_array_equal(here, there)


def test_windows_follow_a_fraction_of_a_pixel() -> None:
    """The coverage's centroid is the window's middle, wherever between the pixels the object is."""
    for x in (40.0, 40.3, 40.5, 40.9):
        cover = object_windows(*disc(x, 30.0, 12.0), size=64, extent=1.6)[0, :, :, 3].astype(float)
        assert cover.sum(axis=0) @ (np.arange(64) + 0.5) / cover.sum() == pytest.approx(32.0, abs=0.06)


def test_windows_scale_with_the_first_silhouette() -> None:
    small = object_windows(*disc(48.0, 48.0, 10.0), size=32, extent=1.6)[..., 3] / 255
    large = object_windows(*disc(48.0, 48.0, 20.0), size=32, extent=1.6)[..., 3] / 255
    assert np.abs(small - large).mean() < 0.03
    area = large[0].mean() * (1.6 * 40 / 20) ** 2  # of the disc over radius²
    assert area == pytest.approx(np.pi, rel=0.03)


def test_later_growth_is_seen_as_growth() -> None:
    cover = object_windows(*joined(disc(48, 48, 10), disc(50, 40, 14)), size=32, extent=2.4)[..., 3].mean(axis=(1, 2))
    assert cover[-1] / cover[0] == pytest.approx(1.96, rel=0.05)


def test_colours_keep_their_side_and_outside_is_grey() -> None:
    window = object_windows(*disc(40.0, 30.0, 12.0), size=32, extent=2.0)[0]
    assert window[16, 12, 0] > 190 > 60 > window[16, 12, 2] and window[16, 20, 2] > 190 > 60 > window[16, 20, 0]
    np.testing.assert_array_equal(window[0, 0], [GREY, GREY, GREY, 0])
    corner = object_windows(*disc(4.0, 4.0, 4.0), size=32, extent=4.0)[0]  # the window reaches beyond the picture
    np.testing.assert_array_equal(corner[0, 0], [GREY, GREY, GREY, 0])


def test_a_frame_without_the_object_is_shown_where_the_one_before_was() -> None:
    frames, mask = disc(70.0, 60.0, 8.0)
    frames[2, 60, 70] = (1, 2, 3)
    mask[2] = 0
    windows = object_windows(frames, mask, size=32, extent=2.0)
    assert windows[2, ..., 3].max() == 0
    assert np.abs(windows[2, ..., :3].astype(int) - windows[1, ..., :3]).max(axis=2).astype(bool).sum() < 8
    nothing = object_windows(frames, np.zeros_like(mask), size=32, extent=2.0)
    np.testing.assert_allclose(nothing[0, 16, 16, :3], frames[0, 48, 48])


def test_vectors_tell_shapes_apart_and_know_the_first_frame() -> None:
    torch.manual_seed(0)
    network = FrameNetwork(16, widths=(8, 16), window=32).eval()

    def vectors(frames: np.ndarray, mask: np.ndarray) -> torch.Tensor:
        return network(normalised(torch.from_numpy(object_windows(frames, mask, size=32, extent=1.6))[None]))

    still = vectors(*disc(40.0, 30.0, 12.0))
    assert still.shape == (1, 3, 16)
    torch.testing.assert_close(still[:, 0], still[:, 2])
    frames, mask = disc(40.0, 30.0, 12.0)
    mask[0, :30] = 0  # half of the disc in the first frame alone
    changed = vectors(frames, mask)
    assert (changed[:, 2] - still[:, 2]).abs().max() > 1e-3
