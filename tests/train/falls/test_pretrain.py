"""Training on falls: what is drawn teaches, the head is fitted after, and the command leaves a checkpoint."""

import json

import pytest
import torch
import yaml
from typer.testing import CliRunner

import train.commands
from data_gen.explicit.store import save_bodies
from models.estimator import PhysicsPredictor
from models.network import PhysicsNetwork
from physconvex.errors import InputError
from train.cache import prepare_clips
from train.data import TrainingClips
from train.falls import Pretraining, pretrain, train_on_falls
from train.falls.real import RealClips
from train.falls.skinning import HeadTraining, fit_skinning_head
from train.records import read_clips

PLAN = Pretraining(minutes=0.1, drawn=4, real=4, report_seconds=2.0)


@pytest.fixture
def clips(tiny_data, tiny_cache, tiny_config) -> TrainingClips:
    records = read_clips([tiny_data], "train")
    prepared = prepare_clips(records, tiny_config.clip, tiny_cache, true_mask_share=0.2, workers=0)
    return TrainingClips(records, prepared, augmentation=tiny_config.augment, modes=3, seed=0)


def test_errors_fall(falls, clips, tiny_config, tmp_path):
    torch.manual_seed(0)
    network = PhysicsNetwork(tiny_config.network)
    real = RealClips.of(clips, "cpu")
    average = pretrain(network, falls, falls, tiny_config, PLAN, tmp_path, real=real, validation=real)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert len(lines) >= 2
    assert lines[-1]["states"] < lines[0]["states"] and lines[-1]["material"] < lines[0]["material"]
    assert set(lines[-1]["real"]) == set(lines[-1]["falls"]) >= {"log10_stiffness_mae", "poisson_mae", "states"}
    assert (tmp_path / "average.safetensors").is_file()
    assert all(bool(value.isfinite().all()) for value in average.state_dict().values())


def test_real_clips_are_the_prepared_ones(clips):
    real = RealClips.of(clips, "cpu")
    shown = real.shown(torch.tensor([3, 5]), true_moments=torch.tensor([False, True]))
    for row, (clip, which) in enumerate(((3, 0), (5, 1))):
        assert torch.equal(shown.windows[row], torch.from_numpy(clips.prepared.windows[clip].copy()).float())
        assert torch.equal(shown.moments[row], torch.from_numpy(clips.prepared.moments[clip, which].copy()))
    assert len(real) == 48


def test_the_head_learns_and_the_rest_stays(clips, tiny_config):
    torch.manual_seed(0)
    network = PhysicsNetwork(tiny_config.network)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    first = fit_skinning_head(network, clips, tiny_config.loss, HeadTraining(looks=1, steps=1))
    last = fit_skinning_head(network, clips, tiny_config.loss, HeadTraining(looks=1, steps=150))
    assert last < 0.8 * first
    changed = {name for name, value in network.state_dict().items() if not torch.equal(value, before[name])}
    assert changed and all(name.startswith("skinning_head.") for name in changed)


@pytest.mark.slow
def test_the_command(bodies, tiny_data, tiny_cache, tiny_config, tmp_path, monkeypatch):
    monkeypatch.setattr("train.falls.run._HELD_OUT", 1)
    (tmp_path / "falls").mkdir()
    save_bodies(tmp_path / "falls" / "falls-0000.npz", [[body] for body in bodies], drawn=(0, 2))
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(tiny_config.model_dump(mode="json")))
    options = {
        "--falls": tmp_path / "falls",
        "--data": tiny_data,
        "--out": tmp_path / "run",
        "--config": tmp_path / "tiny.yaml",
        "--minutes": 0.02,
        "--drawn": 2,
        "--real": 2,
        "--device": "cpu",
        "--cache": tiny_cache,
        "--workers": 1,
    }
    arguments = [str(part) for pair in options.items() for part in pair]
    app = typer_app()
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    predictor = PhysicsPredictor.from_pretrained(tmp_path / "run" / "best")
    assert predictor.config.network == tiny_config.network
    assert "1 falls of 1 shapes" in (tmp_path / "run" / "best" / "model_card.md").read_text()


def typer_app():
    import typer

    app = typer.Typer()
    app.command()(train.commands.pretrain)
    return app


def test_too_few_falls_are_an_error(bodies, tiny_data, tiny_config, tmp_path):
    save_bodies(tmp_path / "falls-0000.npz", [[body] for body in bodies], drawn=(0, 2))
    with pytest.raises(InputError, match="holds 2; expected more than the 80"):
        train_on_falls(tiny_config, PLAN, tmp_path, [tiny_data], tmp_path / "run", device="cpu")
