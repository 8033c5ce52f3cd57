"""The video beside the models: what differs, and when there is nothing to show."""

from types import SimpleNamespace

import numpy as np

from physconvex.gap.page.video_strip import _difference, _drawn, video_strip
from physconvex.identify import MarkerObservations


def test_markers_have_no_video():
    seen = MarkerObservations(np.zeros((2, 3)), np.zeros((4, 2, 3)), np.ones((4, 2)))
    assert video_strip(SimpleNamespace(base=SimpleNamespace(observations=seen))) is None


def test_the_difference_is_signed_and_only_where_the_model_shows_something():
    observed = np.full((2, 2, 3), 200, dtype=np.uint8)
    picture = np.zeros((2, 2, 4), dtype=np.uint8)
    picture[0, 0] = (98, 98, 98, 255)
    picture[0, 1] = (251, 251, 251, 255)
    found = _difference(observed, picture)
    np.testing.assert_allclose(found[0], [102 / 255, -51 / 255])
    assert np.isnan(found[1]).all()


def test_every_frame_has_its_time_and_every_row_its_name():
    image, difference = np.zeros((20, 30, 4), dtype=np.uint8), np.zeros((20, 30))
    figure = _drawn(
        [("observed", [image, image]), ("base model", [image, image])],
        [("observed − base model", [difference, difference])],
        np.array([4, 8]), 24.0, (slice(0, 20), slice(5, 25)),
    )  # fmt: skip
    assert [axes.get_title() for axes in figure.axes[:2]] == ["frame 4, 167 ms", "frame 8, 333 ms"]
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["observed", "base model", "observed −\nbase model"]
