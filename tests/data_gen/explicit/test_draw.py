"""Pictures of a box: where it is, what is in front, and how it is coloured."""

import numpy as np
import pytest
import torch

from data_gen import LOOK, DrawnClips, render_falls
from physconvex.mesh import box_mesh

SIDE, FOCAL, DISTANCE = 64, 64.0, 4.0


def scene(depth: float = DISTANCE) -> dict[str, torch.Tensor]:
    """A unit cube before a camera that looks along y, drawn once, red and lit from everywhere alike."""
    vertices, triangles = box_mesh((1.0, 1.0, 1.0), (1, 1, 1), order=1).surface
    x = torch.from_numpy((vertices - [0.5, 0.0, 0.5] + [0.0, depth, 0.0]).astype(np.float32))
    view = torch.tensor([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0, 0, FOCAL, SIDE / 2, SIDE / 2, 2], dtype=torch.float32)
    look = torch.zeros(LOOK)
    look[:6] = torch.tensor([200.0, 0.0, 0.0, 10.0, 20.0, 30.0])
    look[9] = 1.0
    return {
        "clips": torch.tensor([[0, len(x), 0, len(triangles)]], dtype=torch.int32),
        "views": view.view(1, 1, 16),
        "looks": look[None],
        "positions": x.flatten(),
        "rest": x,
        "triangles": torch.from_numpy(triangles.astype(np.int32)),
    }


def test_a_cube_covers_what_its_front_does():
    picture = render_falls(DrawnClips(**scene()), side=SIDE)[0, 0]
    edge = FOCAL / DISTANCE
    rows, columns = np.nonzero(picture[..., 3].numpy() > 0.5)
    assert picture[..., 3].sum() == pytest.approx(edge**2, rel=0.01)
    for places in (rows, columns):
        assert places.min() + 0.5 == pytest.approx(SIDE / 2 - edge / 2, abs=1)
        assert places.max() + 0.5 == pytest.approx(SIDE / 2 + edge / 2, abs=1)


def test_colours_of_body_and_background():
    picture = render_falls(DrawnClips(**scene()), side=SIDE)[0, 0]
    assert picture[SIDE // 2, SIDE // 2].tolist() == [200, 0, 0, 1]
    assert picture[0, 0].tolist() == [10, 20, 30, 0]


def test_light_falls_on_what_faces_it():
    lit = scene()
    lit["looks"][0, 6:10] = torch.tensor([0.0, -1.0, 0.0, 0.25])  # from behind the camera
    assert render_falls(DrawnClips(**lit), side=SIDE)[0, 0, SIDE // 2, SIDE // 2, 0] == 250  # 200 × 1.25
    lit["looks"][0, 7] = 1.0
    assert render_falls(DrawnClips(**lit), side=SIDE)[0, 0, SIDE // 2, SIDE // 2, 0] == 50


def test_waves_stay_with_the_body():
    """The colour of a point depends on where it was at rest, not on where it is."""
    near, far = scene(), scene()
    for one in (near, far):
        one["looks"][0, 10:17] = torch.tensor([9.0, 0.0, 0.0, 0.3, 0.0, 100.0, 0.0])
    far["positions"] = (near["rest"] + torch.tensor([0.5, 0.0, 0.0])).flatten()
    shift = round(0.5 * FOCAL / DISTANCE)
    first, second = (render_falls(DrawnClips(**one), side=SIDE)[0, 0, SIDE // 2, :, 1].numpy() for one in (near, far))
    inside = slice(SIDE // 2 - 6, SIDE // 2 + 6)
    assert np.ptp(first[inside]) > 50
    assert second[inside.start + shift : inside.stop + shift] == pytest.approx(first[inside], abs=3)


def test_what_is_behind_the_camera_is_not_drawn():
    assert render_falls(DrawnClips(**scene(depth=-5.0)), side=SIDE)[..., 3].sum() == 0


@pytest.mark.gpu
def test_a_gpu_draws_what_the_processor_does():
    given = scene()
    device = render_falls(DrawnClips(**{name: value.cuda() for name, value in given.items()}), side=SIDE)
    assert torch.allclose(render_falls(DrawnClips(**given), side=SIDE), device.cpu(), atol=0.01)
