"""What is told of views: the sides that are missing, and the camera that contradicts the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.reconstruction import disagreement, missing_sides, visual_hull
from tests.reconstruction.scenes import ball_mesh, ring, views


def towards(*degrees: tuple[float, float]) -> np.ndarray:
    """Directions from azimuths and elevations."""
    turn, rise = np.radians(np.array(degrees, dtype=float)).T
    return np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1)


@pytest.mark.parametrize(
    ("cameras", "said"),
    [
        ([(0, 0)], "from azimuth 60° to 300° or from above or from below"),
        ([(0, 0), (90, 0), (180, 0)], "from azimuth 240° to 300° or from above or from below"),
        ([(90, 0), (180, 0), (270, 0), (0, 80), (0, -80)], "from azimuth -30° to 30° (0°"),
        ([(0, 40), (120, 40), (240, 40)], "from azimuth 50° to 70° or from azimuth 170° to 190°"),
        ([(60 * k, 10) for k in range(6)] + [(0, 80)], "no camera sees the body from below"),
    ],
)
def test_missing_sides_are_named(cameras, said):
    assert said in missing_sides(towards(*cameras))


def test_views_from_all_sides_miss_none():
    assert missing_sides(np.array([camera.position for camera in ring(8)])) == ""


def test_the_camera_that_contradicts_the_others_is_named():
    seen = views(6, size=96)
    assert disagreement(seen) == ""
    wrong = replace(seen[2], camera=replace(seen[2].camera, cx=seen[2].camera.cx + 12))
    told = disagreement([*seen[:2], wrong, *seen[3:]])
    assert "'view2' disagrees most: without it, the others have 100 %" in told
    higher = replace(seen[1], camera=replace(seen[1].camera, cy=seen[1].camera.cy + 25))  # of two, rows alone tell
    assert "cameras 'view0' and 'view1' contradict each other" in disagreement([seen[0], higher])


def test_silhouettes_without_common_space_name_the_camera():
    seen = views(6, size=96)
    away = replace(seen[4], camera=replace(seen[4].camera, cx=seen[4].camera.cx + 65))
    with pytest.raises(InputError, match=r"no point in space.*'view4' disagrees most"):
        visual_hull([*seen[:4], away, *seen[5:]])


def test_a_silhouette_that_the_border_cuts_does_not_cut_the_hull():
    """What lies beside a picture is not known to be empty."""
    seen = views(8, size=96)
    rows = seen[0].camera
    cut = replace(
        seen[0],
        camera=replace(rows, h=48),
        **{name: getattr(seen[0], name)[:48] for name in ("image", "background", "coverage")},
    )
    whole, part = visual_hull(seen), visual_hull([cut, *seen[1:]])
    assert part.is_watertight and part.volume > 0.99 * whole.volume
    assert part.volume < 1.2 * ball_mesh().volume
