"""`predict` on one clip."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from inference import predict
from physconvex import InputError
from tests.inference.conftest import MakeClip
from tests.inference.predictor_double import PredictorDouble


def test_defaults_are_named_as_assumed(tmp_path: Path, make_clip: MakeClip) -> None:
    path = make_clip(tmp_path / "a.mp4", fps=30)
    prediction = predict(path, predictor=PredictorDouble())
    assert prediction.path == str(path)
    assert prediction.assumed == ("density=1000 kg/m^3", "object_size=1 m")
    assert (prediction.fps, prediction.density, prediction.object_size) == (pytest.approx(30), 1000.0, 1.0)
    assert prediction.foreground == "background_model" and prediction.frames_used == 12
    given = predict(path, predictor=PredictorDouble(), density=2000.0, object_size=0.5, fps=30.0)
    assert given.assumed == ()
    assert given.youngs_modulus == pytest.approx(prediction.youngs_modulus)


def test_a_notebook_shows_numbers_intervals_and_weights(tmp_path: Path, make_clip: MakeClip) -> None:
    shown = predict(make_clip(tmp_path / "<a>.mp4"), predictor=PredictorDouble())._repr_html_()
    assert "&lt;a&gt;.mp4" in shown and "Pa (" in shown and "assumed density=1000 kg/m^3" in shown
    assert shown.count("data:image/png;base64,") == 1


@pytest.mark.parametrize("paths", [["a.mp4", "b.mp4"], (Path("a.mp4"),), {"a.mp4"}])
def test_several_paths_are_for_predict_batch(paths: object) -> None:
    with pytest.raises(InputError, match="predict_batch"):
        predict(paths, predictor=PredictorDouble())


def test_fps_overrides_the_files(tmp_path: Path, make_clip: MakeClip) -> None:
    path = make_clip(tmp_path / "a.mp4", fps=24)
    slow, fast = (predict(path, fps=fps, predictor=PredictorDouble()) for fps in (12.0, 24.0))
    assert fast.fps == 24 and slow.fps == 12
    assert fast.youngs_modulus == pytest.approx(4 * slow.youngs_modulus)


def test_arrays_of_every_kind_agree(ball: np.ndarray) -> None:
    kinds = [ball, torch.from_numpy(ball), (ball / 255).astype(np.float32), torch.from_numpy(ball / 255)]
    predictions = [predict(kind, predictor=PredictorDouble()) for kind in kinds]
    assert len({prediction.youngs_modulus for prediction in predictions}) == 1
    assert predictions[0].path is None and predictions[0].assumed[0] == "fps=24 1/s"


def test_alpha_and_mask_decide_the_foreground(ball: np.ndarray) -> None:
    inside = np.abs(ball.astype(int) - np.array([40, 90, 200])).max(axis=-1) < 8
    alpha = np.concatenate([ball, (inside * 255).astype(np.uint8)[..., None]], axis=-1)
    by_alpha = predict(alpha, predictor=PredictorDouble())
    by_mask = predict(ball, mask=inside, predictor=PredictorDouble())
    assert (by_alpha.foreground, by_mask.foreground) == ("alpha", "mask")
    assert by_alpha.youngs_modulus == by_mask.youngs_modulus


def test_an_opaque_alpha_tells_nothing(ball: np.ndarray) -> None:
    opaque = np.concatenate([ball, np.full((*ball.shape[:3], 1), 255, np.uint8)], axis=-1)
    found, plain = (predict(frames, predictor=PredictorDouble()) for frames in (opaque, ball))
    assert found.foreground == plain.foreground == "background_model"
    assert found.youngs_modulus == plain.youngs_modulus


def test_timestamps_say_the_rate(ball: np.ndarray) -> None:
    slow = predict(ball, timestamps=np.arange(12) / 12, predictor=PredictorDouble())
    assert slow.fps == pytest.approx(12.0) and not any("fps" in name for name in slow.assumed)
    stated = predict(ball, timestamps=np.arange(12) / 24, fps=12.0, predictor=PredictorDouble())
    assert stated.fps == 12.0 and stated.youngs_modulus == pytest.approx(slow.youngs_modulus)
    assert stated.youngs_modulus != predict(ball, fps=24.0, predictor=PredictorDouble()).youngs_modulus


def test_uneven_timestamps_are_used(ball: np.ndarray) -> None:
    even = predict(ball, timestamps=np.arange(12) / 24, fps=24.0, predictor=PredictorDouble())
    late = np.arange(12) / 24
    late[6:] += 0.5
    uneven = predict(ball, timestamps=late, fps=24.0, predictor=PredictorDouble())
    assert even.frames_used == 12
    assert uneven.youngs_modulus != even.youngs_modulus


def test_image_folder(tmp_path: Path, ball: np.ndarray) -> None:
    for k, image in enumerate(ball):
        Image.fromarray(image).save(tmp_path / f"{k:06d}.png")
    from_files = predict(tmp_path, predictor=PredictorDouble())
    from_array = predict(ball, predictor=PredictorDouble())
    assert from_files.youngs_modulus == from_array.youngs_modulus
    assert from_files.assumed == from_array.assumed


def test_mask_video_beside_the_video(tmp_path: Path, make_clip: MakeClip, ball: np.ndarray) -> None:
    from physconvex.io import write_video

    path = make_clip(tmp_path / "a.mp4")
    inside = np.abs(ball.astype(int) - np.array([40, 90, 200])).max(axis=-1) < 8
    write_video(tmp_path / "a_mask.mp4", np.repeat(inside[..., None], 3, axis=3).astype(np.uint8) * 255, fps=24.0)
    assert predict(path, predictor=PredictorDouble()).foreground == "mask"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"fps": 0.0}, "fps is 0.0"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"density": -1.0}, "density is -1.0"),
        ({"object_size": float("inf")}, "object_size is inf"),
        ({"mask": np.ones((3, 4, 4))}, "mask has shape (3, 4, 4)"),
        ({"timestamps": np.zeros(12)}, "timestamps has shape (12,)"),
    ],
)
def test_bad_options_are_named(ball: np.ndarray, options: dict, says: str) -> None:
    with pytest.raises(InputError, match="expected") as caught:
        predict(ball, predictor=PredictorDouble(), **options)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((12, 3, 64, 64), np.uint8),
        np.zeros((64, 64, 3), np.uint8),
        np.zeros((12, 64, 64, 3), np.int64),
        np.full((12, 64, 64, 3), 200.0),
        np.full((12, 64, 64, 3), np.nan),
        np.zeros((0, 64, 64, 3), np.uint8),
        np.zeros((1, 64, 64, 3), np.uint8),
    ],
)
def test_bad_arrays_are_refused(array: np.ndarray) -> None:
    with pytest.raises(InputError, match="frames"):
        predict(array, predictor=PredictorDouble())


@pytest.mark.parametrize("given", [None, 3, {"frames": 2}])
def test_what_is_no_array_is_refused(given: object) -> None:
    with pytest.raises(InputError, match=r"path_or_array: got .*; expected the path of a clip, or its frames"):
        predict(given, predictor=PredictorDouble())


def test_folders_that_are_no_clip_and_missing_paths(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"without capture\.json"):
        predict(tmp_path, predictor=PredictorDouble())
    with pytest.raises(InputError, match="does not exist"):
        predict(tmp_path / "x.mp4", predictor=PredictorDouble())


def test_json_has_units_and_round_trips(ball: np.ndarray) -> None:
    prediction = predict(ball, predictor=PredictorDouble())
    record = json.loads(prediction.to_json())
    assert record["youngs_modulus"] == prediction.youngs_modulus
    assert record["units"]["youngs_modulus"] == "Pa" and record["schema"] == "physconvex/prediction/1"
    assert record["youngs_modulus_interval"] == list(prediction.youngs_modulus_interval)
