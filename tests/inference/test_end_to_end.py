"""The whole way with a real, tiny, untrained network: files → predictions → files."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import typer
from typer.testing import CliRunner

from inference import iter_predictions, predict, predict_batch
from inference.commands import predict_command as predict_command
from models import EncoderConfig, NetworkConfig, PhysicsPredictor
from physconvex import InputError
from physconvex.reduced import SkinningField
from tests.inference.conftest import MakeClip


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint folder of an untrained network that reads 12 frames of 32×32."""
    encoder = EncoderConfig(image_size=32, frames=12, hidden_size=32, layers=1, heads=2)
    folder = tmp_path_factory.mktemp("checkpoint")
    PhysicsPredictor.from_config(NetworkConfig(encoder=encoder)).save_pretrained(folder)
    return folder


@pytest.fixture
def folder(tmp_path: Path, make_clip: MakeClip) -> Path:
    """Five clips of different size, length and rate."""
    make_clip(tmp_path / "clips" / "a.mp4")
    make_clip(tmp_path / "clips" / "wide.mp4", width=96, height=48, frames=9)
    make_clip(tmp_path / "clips" / "fast.mp4", fps=48, frames=24)
    make_clip(tmp_path / "clips" / "sub" / "a.mp4", width=40, height=120, frames=30)
    make_clip(tmp_path / "clips" / "short.mp4", frames=5)
    return tmp_path / "clips"


@pytest.mark.slow
def test_batch_equals_single_predictions(tmp_path: Path, folder: Path, checkpoint: Path) -> None:
    summary = predict_batch(folder, out=tmp_path / "out", checkpoint=checkpoint, object_size=0.1)
    assert (summary.predicted, summary.failed) == (5, 0)
    for row in summary.rows:
        alone = predict(row.path, checkpoint=checkpoint, object_size=0.1)
        assert row.youngs_modulus == pytest.approx(alone.youngs_modulus, rel=1e-4)
        assert row.poisson_ratio == pytest.approx(alone.poisson_ratio, abs=1e-5)
        assert row.youngs_modulus_low < row.youngs_modulus < row.youngs_modulus_high
        field = SkinningField.load(tmp_path / "out" / "clips" / f"{row.name}.skinning.safetensors")
        points = np.random.default_rng(0).uniform(-0.05, 0.05, (6, 3))
        np.testing.assert_allclose(field(points), alone.skinning_field(points), rtol=1e-3, atol=1e-4)
    page = (tmp_path / "out" / "gallery.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 5 and page.count("data:image/png;base64,") == 5
    assert 'src="http' not in page and 'href="http' not in page, "the page stands alone"


def test_scale_of_time_and_size(folder: Path, checkpoint: Path) -> None:
    """Twice the size and 1/√2 of the rate is the same motion: exactly twice E, the same ν."""
    small = predict(folder / "a.mp4", checkpoint=checkpoint, fps=24.0, object_size=0.1)
    large = predict(folder / "a.mp4", checkpoint=checkpoint, fps=24 / 2**0.5, object_size=0.2)
    assert large.frames_used == small.frames_used
    assert large.youngs_modulus == pytest.approx(2 * small.youngs_modulus, rel=1e-4)
    assert large.poisson_ratio == pytest.approx(small.poisson_ratio, abs=1e-5)


@pytest.mark.slow
def test_iter_predictions_leaves_torch_as_it_was(folder: Path, checkpoint: Path) -> None:
    threads = torch.get_num_threads()
    results = list(iter_predictions(folder, checkpoint=checkpoint))
    assert len(results) == 5 and all(result.prediction for result in results)
    assert torch.get_num_threads() == threads


def test_command(tmp_path: Path, folder: Path, checkpoint: Path) -> None:
    (folder / "text.mp4").write_text("no video")
    app = typer.Typer()
    app.command()(predict_command)
    arguments = [str(folder), "--out", str(tmp_path / "out"), "--checkpoint", str(checkpoint), "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    records = {Path(record["path"]).name: record for record in map(json.loads, result.stdout.splitlines())}
    assert set(records) == {"a.mp4", "wide.mp4", "fast.mp4", "short.mp4", "text.mp4"}
    assert records["wide.mp4"]["assumed"] == ["density=1000 kg/m^3", "object_size=1 m"]
    assert "text.mp4" in result.stderr
    run = json.loads((tmp_path / "out" / "run.json").read_text())["runs"][0]
    assert run["configuration"]["checkpoint"] == str(checkpoint) and run["finished"]
    assert len(run["configuration"]["checkpoint_digest"]) == 16


def test_a_missing_checkpoint_is_bad_input(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="checkpoint"):
        predict_batch(folder, out=tmp_path / "out", checkpoint="nowhere")
