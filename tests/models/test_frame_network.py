"""Windows that follow the object, and what the network over them reads."""

import pytest
import torch
from torch import Tensor

from models.frame_network import FrameNetwork, object_windows


def disc(x: float, y: float, radius: float, *, side: int = 96, frames: int = 3) -> tuple[Tensor, Tensor]:
    """A disc about (x, y), red on its left half and blue on its right, as one clip that stands still."""
    places = torch.arange(side) + 0.5
    distance = torch.hypot(places[None] - x, places[:, None] - y)
    mask = (255 * (radius - distance + 0.5).clamp(0, 1)).to(torch.uint8)
    image = torch.full((side, side, 3), 127, dtype=torch.uint8)
    inside, left = mask > 0, (places < x).expand(side, side)
    image[inside & left], image[inside & ~left] = torch.tensor([[220, 30, 30], [30, 30, 220]], dtype=torch.uint8)
    return image.expand(1, frames, -1, -1, -1).clone(), mask.expand(1, frames, -1, -1).clone()


def test_windows_show_the_same_wherever_the_object_is() -> None:
    here = object_windows(*disc(40.0, 30.0, 12.0), size=32, extent=1.6)
    there = object_windows(*disc(61.0, 55.0, 12.0), size=32, extent=1.6)
    assert here.shape == (1, 3, 4, 32, 32)
    torch.testing.assert_close(here, there, atol=1e-4, rtol=0)


def test_windows_scale_with_the_first_silhouette() -> None:
    small = object_windows(*disc(48.0, 48.0, 10.0), size=32, extent=1.6)
    large = object_windows(*disc(48.0, 48.0, 20.0), size=32, extent=1.6)
    assert (small[:, :, 3] - large[:, :, 3]).abs().mean() < 0.03
    area = large[0, 0, 3].mean() * (1.6 * 40 / 20) ** 2  # of the disc over radius²
    assert float(area) == pytest.approx(torch.pi, rel=0.03)


def test_later_growth_is_seen_as_growth() -> None:
    frames, mask = (torch.cat([a, b], dim=1) for a, b in zip(disc(48, 48, 10), disc(50, 40, 14), strict=True))
    cover = object_windows(frames, mask, size=32, extent=2.4)[0, :, 3].mean(dim=(1, 2))
    assert float(cover[-1] / cover[0]) == pytest.approx(1.96, rel=0.05)


def test_colours_keep_their_side_and_outside_is_grey() -> None:
    window = object_windows(*disc(40.0, 30.0, 12.0), size=32, extent=2.0)[0, 0]
    assert window[0, 16, 12] > 0.5 > window[2, 16, 12] and window[2, 16, 20] > 0.5 > window[0, 16, 20]
    assert window[:3, 0, 0].abs().max() < 0.01 and window[3, 0, 0] == 0
    corner = object_windows(*disc(4.0, 4.0, 4.0), size=32, extent=4.0)[0, 0]  # the window reaches beyond the picture
    assert corner[:, 0, 0].abs().max() == 0


def test_a_frame_without_the_object_shows_the_middle() -> None:
    frames, mask = disc(70.0, 70.0, 8.0)
    mask[:, 2] = 0
    windows = object_windows(frames, mask, size=32, extent=2.0)
    assert torch.isfinite(windows).all() and windows[0, 2, 3].max() == 0


def test_vectors_tell_shapes_apart_and_know_the_first_frame() -> None:
    torch.manual_seed(0)
    network = FrameNetwork(16, widths=(8, 16), window=32).eval()
    still = network(*disc(40.0, 30.0, 12.0))
    assert still.shape == (1, 3, 16)
    torch.testing.assert_close(still[:, 0], still[:, 2])
    frames, mask = disc(40.0, 30.0, 12.0)
    mask[:, 0, :30] = 0  # half of the disc in the first frame alone
    changed = network(frames, mask)
    assert (changed[:, 2] - still[:, 2]).abs().max() > 1e-3
