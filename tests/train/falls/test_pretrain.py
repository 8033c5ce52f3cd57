"""Training on falls: what is drawn teaches, the head is fitted after, and the command leaves a checkpoint."""

import itertools
import json
import sys
from types import SimpleNamespace

import pytest
import torch
import yaml
from typer.testing import CliRunner

import train.commands
from data_gen.explicit.generate import save_bodies
from models import PhysicsNetwork, PhysicsPredictor
from physconvex import InputError
from train import Pretraining, RealClips, TrainingClips, prepare_clips, pretrain, read_clips, train_on_falls
from train.falls.run import HeadTraining, fit_skinning_head

PLAN = Pretraining(steps=24, drawn=4, real=4, report_steps=6)


@pytest.fixture
def clips(tiny_data, tiny_cache, tiny_config) -> TrainingClips:
    records = read_clips([tiny_data], "train")
    prepared = prepare_clips(records, tiny_config.clip, tiny_cache, true_mask_share=0.2, workers=0)
    return TrainingClips(records, prepared, augmentation=tiny_config.augment, modes=3, seed=0)


def lines_of(run):
    return [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]


def test_errors_fall(falls, clips, tiny_config, tmp_path):
    torch.manual_seed(0)
    network = PhysicsNetwork(tiny_config.network)
    real = RealClips.of(clips, "cpu")
    average = pretrain(network, falls, falls, tiny_config, PLAN, out=tmp_path, real=real, validation=real)
    lines = lines_of(tmp_path)
    trained, looked = ([line for line in lines if line["kind"] == kind] for kind in ("train", "validation"))
    assert [line["step"] for line in trained] == [line["step"] for line in looked] == [6, 12, 18, 24]
    assert trained[-1]["states"] < trained[0]["states"] and trained[-1]["material"] < trained[0]["material"]
    assert set(looked[-1]["real"]) == set(looked[-1]["falls"]) >= {"log10_stiffness_mae", "poisson_mae", "states"}
    assert all(bool(value.isfinite().all()) for value in average.state_dict().values())
    assert list((tmp_path / "tensorboard").iterdir())


class _Killed(Exception):
    pass


def test_killed_and_resumed_is_the_same_run(falls, clips, tiny_config, tmp_path):
    plan = Pretraining(steps=6, drawn=2, real=2, report_steps=2)
    real = RealClips.of(clips, "cpu")

    def run(folder, report=None, mark="a"):
        torch.manual_seed(0)
        network = PhysicsNetwork(tiny_config.network)
        return pretrain(
            network, falls, falls, tiny_config, plan, out=folder,
            real=real, validation=real, fingerprint=mark, report=report,
        )  # fmt: skip

    def kill(name, done, total):
        if done == 5:
            raise _Killed

    whole = run(tmp_path / "whole")
    with pytest.raises(_Killed):
        run(tmp_path / "killed", report=kill)
    assert [line["step"] for line in lines_of(tmp_path / "killed")] == [2, 2, 4, 4]
    with pytest.raises(InputError, match="another configuration"):
        run(tmp_path / "killed", mark="b")
    steps = []
    resumed = run(tmp_path / "killed", report=lambda name, done, total: steps.append(done))
    assert steps == [5, 6]
    kept = [
        [{k: v for k, v in line.items() if k not in ("time", "seconds")} for line in lines_of(tmp_path / name)]
        for name in ("whole", "killed")
    ]
    assert kept[0] == kept[1]
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name])


def test_the_best_is_kept_and_not_the_last(falls, tiny_config, tmp_path, monkeypatch):
    found, seen = iter([2.0, 1.0, 3.0]), []

    def look(network, batches):
        seen.append({name: value.clone() for name, value in network.state_dict().items()})
        return {}

    module = sys.modules[pretrain.__module__]
    monkeypatch.setattr(module, "_score", lambda *_: next(found))
    monkeypatch.setattr(module, "scores", look)
    torch.manual_seed(0)
    plan = Pretraining(steps=3, drawn=2, real=2, report_steps=1)
    best = pretrain(PhysicsNetwork(tiny_config.network), falls, falls, tiny_config, plan, out=tmp_path)
    for name, value in best.state_dict().items():
        assert torch.equal(value, seen[1][name])
    assert any(not torch.equal(value, seen[2][name]) for name, value in best.state_dict().items())


def test_a_budget_of_time_ends_it(falls, tiny_config, tmp_path, monkeypatch):
    ticks = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: 0.05 * next(ticks))
    monkeypatch.setattr(sys.modules[pretrain.__module__], "time", clock)
    torch.manual_seed(0)
    plan = Pretraining(steps=10_000, minutes=0.01, drawn=2, real=2, report_steps=10_000)
    pretrain(PhysicsNetwork(tiny_config.network), falls, falls, tiny_config, plan, out=tmp_path)
    trained, looked = lines_of(tmp_path)
    assert 5 < trained["step"] < 20 and looked["step"] == trained["step"]
    assert trained["learning_rate"] < 0.2 * tiny_config.learning_rate


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
    few = HeadTraining(looks=1, steps=20)
    monkeypatch.setattr(
        "train.falls.run.fit_skinning_head", lambda *given, **options: fit_skinning_head(*given[:3], few)
    )
    (tmp_path / "falls").mkdir()
    save_bodies(tmp_path / "falls" / "falls-0000.npz", [[body] for body in bodies], drawn=(0, 2))
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(tiny_config.model_dump(mode="json")))
    options = {
        "--falls": tmp_path / "falls",
        "--data": tiny_data,
        "--out": tmp_path / "run",
        "--config": tmp_path / "tiny.yaml",
        "--steps": 2,
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
    other = ["7" if before == "--drawn" else part for before, part in zip(["", *arguments], arguments, strict=False)]
    refused = CliRunner().invoke(app, other)
    assert isinstance(refused.exception, InputError) and "another configuration" in str(refused.exception)


def typer_app():
    import typer

    app = typer.Typer()
    app.command()(train.commands.pretrain_command)
    return app


def test_too_few_falls_are_an_error(bodies, tiny_data, tiny_config, tmp_path):
    save_bodies(tmp_path / "falls-0000.npz", [[body] for body in bodies], drawn=(0, 2))
    with pytest.raises(InputError, match="holds 2; expected more than the 80"):
        train_on_falls(tiny_config, PLAN, tmp_path, [tiny_data], tmp_path / "run", device="cpu")
