"""What there is to look at: strips, skinning sections, the page, numbers in readable units."""

import io
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inference import format_pascals, format_pascals_range, frame_strip, weight_maps
from inference.gallery import write_gallery
from inference.loading import load_array
from inference.pictures import shown_source_frames
from inference.streaming import read_ahead
from inference.table import ResultRow
from models import ClipConfig, prepare_clip
from tests.inference.conftest import falling_ball


def test_the_strip_shows_the_source_with_an_outline() -> None:
    ball = falling_ball()
    loaded = load_array(ball, fps=24.0)
    prepared = prepare_clip(ball, fps=24.0, config=ClipConfig(image_size=32, frames=12))
    strip = np.asarray(Image.open(io.BytesIO(frame_strip(loaded, prepared, count=4, side=96))))
    assert strip.shape == (96, 4 * 96 + 3 * 3, 3)
    bright = (strip[..., 1] > 120) & (strip[..., 2] > 180) & (strip[..., 0] < 110)
    assert bright.sum() > 100, "the outline is drawn"
    assert np.abs(strip[:40, :20].astype(int).mean() - 160) < 15, "the background is the clip's own"


@pytest.mark.parametrize(("fps", "frames"), [(24.0, 12), (48.0, 24), (60.0, 30)])
def test_shown_frames_are_those_that_were_prepared(fps: float, frames: int) -> None:
    ball = falling_ball(frames=frames)
    prepared = prepare_clip(ball, fps=fps, config=ClipConfig(image_size=64, frames=12, margin=0.0))
    indices = shown_source_frames(load_array(ball, fps=fps), prepared)[prepared.valid]
    steps = np.diff(indices)
    assert (steps == round(fps / prepared.fps)).all() and indices[-1] < frames


def test_weight_maps_show_each_weight_inside_the_silhouette() -> None:
    silhouette = np.zeros((40, 40), np.uint8)
    silhouette[10:20, 5:35] = 255  # 30 wide, 10 high

    seen = {}

    def field(points: np.ndarray) -> np.ndarray:
        seen["points"] = points
        return np.stack([points[:, 0], -points[:, 0], points[:, 2]], axis=1).astype(np.float32)

    sheet = np.asarray(Image.open(io.BytesIO(weight_maps(field, silhouette, 0.3))))
    points = seen["points"]
    assert np.ptp(points[:, 0]) == pytest.approx(0.3, rel=0.03) and np.ptp(points[:, 2]) == pytest.approx(0.1, rel=0.1)
    assert (points[:, 1] == 0).all()
    assert 0.1 < (sheet[..., 3] > 0).mean() < 0.5, "transparent outside the silhouette"
    first = sheet[:56, -3 * 60 + 4 : -2 * 60]
    row = first[28][first[28, :, 3] > 0]
    assert row[0, 2] > row[0, 0] and row[-1, 0] > row[-1, 2], "least is blue on the left, greatest red on the right"
    assert weight_maps(field, np.zeros((40, 40), np.uint8), 0.3) == b""


class _Checker(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attributes: object) -> None:
        if tag not in ("meta", "img", "br", "line", "rect", "circle", "path"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("line", "rect", "circle", "path"):
            assert self.open.pop() == tag


def test_the_page_is_well_formed_and_escapes_names(tmp_path: Path) -> None:
    fine = ResultRow(
        path="<b>a&b</b>.mp4",
        youngs_modulus=2e5,
        poisson_ratio=0.4,
        log10_youngs_modulus_std=0.1,
        poisson_ratio_std=0.02,
        youngs_modulus_low=1e5,
        youngs_modulus_high=4e8,
        poisson_ratio_low=0.37,
        poisson_ratio_high=0.43,
        fps=24.0,
        density=1000.0,
        object_size=1.0,
        foreground="background_model",
        foreground_confidence=0.9,
        frames_used=24,
        assumed="density=1000 kg/m^3",
        name="a",
    )
    page = write_gallery(tmp_path, [fine, ResultRow(path="x", error="x: <broken>")]).read_text()
    checker = _Checker()
    checker.feed(page)
    assert checker.open == []
    assert "<b>a&b" not in page and "&lt;b&gt;a&amp;b" in page and "x: &lt;broken&gt;" in page
    assert "200 kPa" in page and "assumed density=1000 kg/m^3" in page and "1 GPa" in page
    assert "Predictions" in write_gallery(tmp_path, []).read_text()


@pytest.mark.parametrize(
    ("value", "text"), [(12.3, "12.3 Pa"), (99_949.0, "99.9 kPa"), (1.234e6, "1.23 MPa"), (4.56e9, "4.56 GPa")]
)
def test_pascals(value: float, text: str) -> None:
    assert format_pascals(value) == text


def test_ranges_have_one_unit_unless_their_ends_are_far_apart() -> None:
    assert format_pascals_range(1.24e5, 2.601e6) == "0.12–2.6 MPa"
    assert format_pascals_range(8.1e5, 1.9e6) == "0.81–1.9 MPa"
    assert format_pascals_range(120.0, 450.0) == "120–450 Pa"
    assert format_pascals_range(1.2e3, 4.5e5) == "1.2–450 kPa"
    assert format_pascals_range(3.9e3, 1.014e6) == "3.9 kPa–1.0 MPa"


def test_read_ahead_keeps_the_order_and_passes_errors_on() -> None:
    def items():
        yield from range(5)
        raise RuntimeError("spent")

    got = []
    with pytest.raises(RuntimeError, match="spent"):
        for item in read_ahead(items(), depth=2):
            got.append(item)
    assert got == list(range(5))


def test_read_ahead_closes_the_generator_when_left_early() -> None:
    closed = []

    def items():
        try:
            yield from range(1000)
        finally:
            closed.append(True)

    ahead = read_ahead(items(), depth=2)
    assert next(ahead) == 0
    ahead.close()
    assert closed == [True]
