"""Capture folders: rate, density and size come from their own files."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from inference import predict, predict_batch
from physconvex.io import write_video
from tests.inference.predictor_double import PredictorDouble


def write_capture(folder: Path, frames: np.ndarray, **changes: object) -> Path:
    """A capture of one camera with a box of 0.2 × 0.1 × 0.1 m as mesh."""
    folder.mkdir(parents=True)
    height, width = frames.shape[1:3]
    camera = {"name": "front", "w": width, "h": height, "fl_x": 70.0, "fl_y": 70.0, "cx": width / 2, "cy": height / 2}
    camera["transform_matrix"] = [[1, 0, 0, 0], [0, 0, -1, -2], [0, 1, 0, 0.5], [0, 0, 0, 1]]
    values = {"fps": 30.0, "frames": len(frames), "density": 800.0, "cameras": [camera]} | changes
    (folder / "capture.json").write_text(json.dumps({key: value for key, value in values.items() if value}))
    write_video(folder / "front.mp4", frames, fps=24.0)  # not the capture's rate
    trimesh.creation.box((0.2, 0.1, 0.1)).export(folder / "mesh.ply")
    return folder


def test_rate_density_and_size_come_from_the_capture(tmp_path: Path, ball: np.ndarray) -> None:
    prediction = predict(write_capture(tmp_path / "c", ball), predictor=PredictorDouble())
    assert (prediction.fps, prediction.density) == (30.0, 800.0)
    assert prediction.object_size == pytest.approx(0.2)
    assert prediction.assumed == () and prediction.warnings == ()


def test_what_the_capture_does_not_state_is_assumed_and_options_override(tmp_path: Path, ball: np.ndarray) -> None:
    folder = write_capture(tmp_path / "c", ball, density=None)
    (folder / "mesh.ply").unlink()
    assert predict(folder, predictor=PredictorDouble()).assumed == ("density=1000 kg/m^3", "object_size=1 m")
    given = predict(folder, density=500.0, object_size=0.3, fps=60.0, predictor=PredictorDouble())
    assert (given.fps, given.density, given.object_size, given.assumed) == (60, 500, 0.3, ())


def test_frames_that_are_to_be_predicted_are_not_looked_at(tmp_path: Path, ball: np.ndarray) -> None:
    spoilt = ball.copy()
    spoilt[8:] = 0
    options = {"observed_frames": 8}
    predictions = [
        predict(write_capture(tmp_path / name, frames, **options), predictor=PredictorDouble())
        for name, frames in (("a", ball), ("b", spoilt))
    ]
    assert predictions[0].frames_used == 8
    assert predictions[0].youngs_modulus == pytest.approx(predictions[1].youngs_modulus, rel=0.01)


def test_the_mask_of_a_capture_is_used(tmp_path: Path, ball: np.ndarray) -> None:
    folder = write_capture(tmp_path / "c", ball)
    inside = np.abs(ball.astype(int) - np.array([40, 90, 200])).max(axis=-1) < 8
    write_video(folder / "front_mask.mp4", np.repeat(inside[..., None], 3, axis=3).astype(np.uint8) * 255, fps=24.0)
    assert predict(folder, predictor=PredictorDouble()).foreground == "mask"


@pytest.mark.slow
def test_captures_in_a_batch(tmp_path: Path, ball: np.ndarray) -> None:
    write_capture(tmp_path / "clips" / "one", ball)
    write_capture(tmp_path / "clips" / "moon", ball, gravity=[0, 0, -1.62])
    (write_capture(tmp_path / "clips" / "lost", ball) / "front.mp4").unlink()
    write_capture(tmp_path / "clips" / "blind", ball, cameras=None)
    summary = predict_batch(tmp_path / "clips", out=tmp_path / "out", predictor=PredictorDouble())
    rows = {row.name: row for row in summary.rows}
    assert rows["one"].error == "" and "gravity is 1.62" in rows["moon"].warnings
    assert "front.mp4" in rows["lost"].error and "no camera" in rows["blind"].error
    assert (summary.predicted, summary.failed) == (2, 2)
