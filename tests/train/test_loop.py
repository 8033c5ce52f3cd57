"""The loop learns, and goes on after a kill as if nothing had happened."""

import json
import os
import signal
import subprocess
import sys
import time
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from models import PhysicsPredictor, load_checkpoint
from physconvex import InputError
from train import TrainConfig, loop, read_clips, train_predictor
from train.config import AugmentConfig

ROOT = Path(__file__).parents[2]


def losses(run: Path) -> list[float]:
    lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    steps = [line["step"] for line in lines if line["kind"] == "train"]
    assert steps == list(range(1, len(steps) + 1))
    return [line["total"] for line in lines if line["kind"] == "train"]


def validations(run: Path) -> list[dict]:
    lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    return [line for line in lines if line["kind"] == "validation"]


@pytest.mark.slow
def test_it_learns_stiffness_from_motion(
    tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    unchanged = dict.fromkeys(AugmentConfig.model_fields, 0)  # clips as they are: learnt in half of the steps
    config = tiny_config.model_copy(
        update={"epochs": 70, "validate_every": 10, "augment": AugmentConfig.model_validate(unchanged)}
    )
    result = train_predictor(config, [tiny_data], tmp_path, cpu=True, cache=tiny_cache)
    history = losses(tmp_path)
    assert np.mean(history[-6:]) < 0.8 * np.mean(history[:6])
    predictor = PhysicsPredictor.from_pretrained(result.checkpoint)
    records = read_clips([tiny_data], "test")
    clips = [predictor.prepare(clip.record.frames(), fps=clip.fps) for clip in records]
    estimates = predictor.estimate(clips, density=[1000.0] * len(clips), object_size=[1.0] * len(clips))
    truth = np.log10([record.youngs_modulus for record in records])
    error = np.abs(np.log10([e.youngs_modulus for e in estimates]) - truth).mean()
    assert error < 0.5 * np.abs(truth - np.median(truth)).mean()
    card = (result.checkpoint / "model_card.md").read_text()
    assert "48 clips" in card and "(12 clips" in card


@pytest.mark.slow
def test_killed_and_resumed_is_the_same_run(
    tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    config = tiny_config.model_copy(update={"checkpoint_seconds": 0.0})
    train_predictor(config, [tiny_data], whole, cpu=True, cache=tiny_cache)
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(config.model_dump_json())  # JSON is YAML
    command = [sys.executable, "-m", "physconvex", "train", "--data", tiny_data, "--out", killed, "--config", recipe]
    kills, errors = 0, tmp_path / "errors"
    for _ in range(3):
        with errors.open("wb") as sink:
            process = subprocess.Popen(
                [*map(str, command), "--device", "cpu", "--cache", str(tiny_cache)],
                cwd=ROOT,
                env=os.environ | {"PYTHONPATH": str(ROOT)},
                stdout=subprocess.DEVNULL,
                stderr=sink,
            )
            kills += kill_after_a_few_steps(process, killed / "log.jsonl", finish=kills == 2)
    assert kills == 2 and process.returncode == 0, errors.read_text()
    assert losses(killed) == losses(whole)
    assert [v["score"] for v in validations(killed)] == [v["score"] for v in validations(whole)]
    tensors = [(run / "best" / "model.safetensors").read_bytes() for run in (whole, killed)]
    assert tensors[0] == tensors[1]


def kill_after_a_few_steps(process: subprocess.Popen, log: Path, *, finish: bool) -> int:
    """Kill −9 when the log has grown by a few lines; 1 if that came before the end."""

    def lines() -> int:
        return len(log.read_text().splitlines()) if log.exists() else 0

    before = lines()
    while process.poll() is None:
        if not finish and lines() >= before + 5:
            process.send_signal(signal.SIGKILL)
            process.wait()
            return 1
        time.sleep(0.005)
    return 0


def test_other_configuration_in_the_same_folder_is_refused(
    tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    config = tiny_config.model_copy(update={"epochs": 1})
    train_predictor(config, [tiny_data], tmp_path, cpu=True, cache=tiny_cache)
    other = config.model_copy(update={"learning_rate": 1e-5})
    with pytest.raises(InputError, match="another configuration"):
        train_predictor(other, [tiny_data], tmp_path, cpu=True, cache=tiny_cache)
    again = train_predictor(config, [tiny_data], tmp_path, cpu=True, cache=tiny_cache)  # complete: nothing to do
    assert again.steps == 6


def test_budget_ends_the_run_with_a_checkpoint(
    tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = count()
    monkeypatch.setattr(loop, "time", SimpleNamespace(monotonic=lambda: 0.05 * next(ticks)))  # as busy as may be
    config = tiny_config.model_copy(update={"epochs": 10_000})
    result = train_predictor(config, [tiny_data], tmp_path, cpu=True, cache=tiny_cache, minutes=0.03)
    assert 10 < result.steps < 100
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    rates = [line["learning_rate"] for line in lines if line["kind"] == "train"]
    assert rates[-1] < 0.2 * max(rates)
    assert PhysicsPredictor.from_pretrained(result.checkpoint).config.calibration.clips == 12


@pytest.mark.slow
def test_two_processes(tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path) -> None:
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(tiny_config.model_dump_json())
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc_per_node=2", "--standalone", "-m"]
    command += ["physconvex", "train", "--data", tiny_data, "--out", tmp_path / "run", "--config", recipe]
    launcher = subprocess.Popen(
        [*map(str, command), "--device", "cpu", "--cache", str(tiny_cache), "--threads", "1"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        errors = launcher.communicate(timeout=240)[1]
    finally:
        launcher.terminate()  # the launcher ends its processes with it
        launcher.wait()
    assert launcher.returncode == 0, errors
    assert len(losses(tmp_path / "run")) == 24
    train_predictor(tiny_config, [tiny_data], tmp_path / "alone", cpu=True, cache=tiny_cache)
    alone = losses(tmp_path / "alone")
    together = losses(tmp_path / "run")  # of the main process's half of each batch
    assert abs(np.mean(together) - np.mean(alone)) < 0.1 * np.mean(alone)


@pytest.mark.slow
def test_training_goes_on_from_a_checkpoint(
    tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    first = train_predictor(tiny_config, [tiny_data], tmp_path / "first", cpu=True, cache=tiny_cache)
    still = tiny_config.model_copy(
        update={"checkpoint": str(first.checkpoint), "learning_rate": 1e-12, "weight_decay": 0.0, "epochs": 1}
    )
    second = train_predictor(still, [tiny_data], tmp_path / "second", cpu=True, cache=tiny_cache)
    assert first.best_score is not None
    assert second.best_score == pytest.approx(first.best_score, abs=2e-2)  # stored in float16
    card = (second.checkpoint / "model_card.md").read_text()
    assert "It went on from the checkpoint `best`" in card
    assert "> 48 clips" in card  # what the first card says


@pytest.mark.slow
def test_weights_between_checkpoint_and_end_are_taken_where_they_are_better(
    tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps far beyond the good weights: on the way back lies something better."""
    monkeypatch.setattr(loop, "_SHARES", (0.01, 0.5))
    first = train_predictor(tiny_config, [tiny_data], tmp_path / "first", cpu=True, cache=tiny_cache)
    wild = tiny_config.model_copy(
        update={"checkpoint": str(first.checkpoint), "learning_rate": 1.0, "epochs": 1, "ema_decay": 0.0}
    )
    out = tmp_path / "second"
    second = train_predictor(wild, [tiny_data], out, cpu=True, cache=tiny_cache)
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    scores = {line["share"]: line["score"] for line in lines if line["kind"] == "between"}
    (end,) = [line["score"] for line in lines if line["kind"] == "validation"]
    share = min(scores, key=scores.__getitem__)
    assert second.best_score == scores[share] < end
    assert f"{share:.0%} of the way" in (second.checkpoint / "model_card.md").read_text()
    start, _ = load_checkpoint(str(first.checkpoint))
    found, _ = load_checkpoint(str(second.checkpoint))
    moved = [(a - b).abs().max() for a, b in zip(start.parameters(), found.parameters(), strict=True)]
    assert max(moved) > 1e-3
    again = train_predictor(wild, [tiny_data], out, cpu=True, cache=tiny_cache)  # finished: nothing changes
    assert again.best_score == second.best_score


def test_a_checkpoint_of_another_network_is_named(
    tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig, tmp_path: Path
) -> None:
    other = tiny_config.model_copy(update={"checkpoint": "default"})
    with pytest.raises(InputError, match="default holds another network"):
        train_predictor(other, [tiny_data], tmp_path, cpu=True, cache=tiny_cache)


def test_one_place_to_start_from() -> None:
    with pytest.raises(ValueError, match="both say where to start"):
        TrainConfig(pretrained="MCG-NJU/videomae-small", checkpoint="default")
