"""Intervals fitted anew: they hold nine tenths of each kind's clips, and nothing else changes."""

from pathlib import Path

import numpy as np
import pytest
import torch
import typer
from typer.testing import CliRunner

import train.commands
from models import BinConfig, Calibration, DensityCalibration, PhysicsPredictor, fit_density_calibration
from physconvex import InputError
from train import TrainConfig
from train.held_out import held_out, held_out_estimates
from train.recalibration import recalibrate

BINS = BinConfig(low=-4.0, high=4.0, bins=160)


@pytest.fixture
def checkpoint(tiny_config: TrainConfig, tmp_path: Path) -> Path:
    """Whose intervals are far too narrow."""
    predictor = PhysicsPredictor.from_config(tiny_config.network)
    narrow = DensityCalibration(central_level=0.05)
    predictor.config = predictor.config.model_copy(
        update={"calibration": Calibration(stiffness=narrow, poisson=narrow, clips=9)}
    )
    predictor.save_pretrained(tmp_path / "checkpoint", model_card="# card\n\nof the network\n")
    return tmp_path / "checkpoint"


def covered(checkpoint: Path, data: Path, cache: Path) -> float:
    """Share of validation clips whose E the interval holds, as inference says it."""
    predictor = PhysicsPredictor.from_pretrained(checkpoint)
    clips = held_out([data], predictor, split="validation", cache=cache)
    inside = [
        estimate.youngs_modulus_interval[0] <= label.youngs_modulus <= estimate.youngs_modulus_interval[1]
        for estimate, label in zip(held_out_estimates(predictor, clips), clips.labels, strict=True)
    ]
    return float(np.mean(inside))


def test_intervals_of_a_checkpoint_hold_the_clips(
    tiny_data: Path, tiny_cache: Path, checkpoint: Path, tmp_path: Path
) -> None:
    assert covered(checkpoint, tiny_data, tiny_cache) < 0.5
    out = tmp_path / "calibrated"
    result = recalibrate([tiny_data], out, checkpoint=str(checkpoint), cache=tiny_cache)
    share = covered(out, tiny_data, tiny_cache)
    # the clip that the width is taken from lies on the edge of its interval, and rounding decides
    assert abs(share - result.stiffness[0].coverage) < 1.5 / 12 and share >= 0.9
    before, after = (PhysicsPredictor.from_pretrained(folder) for folder in (checkpoint, out))
    for name, value in before.network.state_dict().items():
        torch.testing.assert_close(after.network.state_dict()[name], value, rtol=0, atol=0)
    assert after.config.calibration == result.calibration and result.calibration.clips == 12
    card = (out / "model_card.md").read_text()
    assert card.startswith("# card\n\nof the network\n") and card.count("## Calibration") == 1
    again = recalibrate([tiny_data], tmp_path / "again", checkpoint=str(out), cache=tiny_cache)
    assert again == result and (tmp_path / "again" / "model_card.md").read_text() == card


def test_a_checkpoint_is_not_overwritten(tiny_data: Path, checkpoint: Path) -> None:
    before = (checkpoint / "config.json").read_bytes()
    with pytest.raises(InputError, match="another folder"):
        recalibrate([tiny_data], checkpoint, checkpoint=str(checkpoint))
    assert (checkpoint / "config.json").read_bytes() == before


def test_the_command_tells_coverage(tiny_data: Path, tiny_cache: Path, checkpoint: Path, tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(train.commands.calibrate_command)
    result = CliRunner().invoke(
        app,
        [
            "--data",
            str(tiny_data),
            "--out",
            str(tmp_path / "o"),
            "--checkpoint",
            str(checkpoint),
            "--cache",
            str(tiny_cache),
        ],
    )
    assert result.exit_code == 0, result.output
    assert "12 clips; the intervals cover" in result.output and (tmp_path / "o" / "config.json").is_file()


def test_every_kind_counts_alike() -> None:
    """Few clips of a kind that the network errs on widen the interval as far as many of one that it knows narrow it."""
    generator = torch.Generator().manual_seed(0)
    middles = torch.linspace(BINS.low, BINS.high, BINS.bins + 1)[:-1] + (BINS.high - BINS.low) / BINS.bins / 2
    errors = torch.cat([0.2 * torch.randn(2000, generator=generator), 0.8 * torch.randn(200, generator=generator)])
    logits = (-0.5 * (middles / 0.4).square()).expand(2200, -1)
    weights = torch.cat([torch.full((2000,), 1 / 2000), torch.full((200,), 1 / 200)])
    alike = fit_density_calibration(logits, errors, BINS, weights=weights)
    low, high = (float(end[0]) for end in alike.interval(alike.density(logits[:1], BINS)))
    known, strange = (((low <= part) & (part <= high)).float().mean() for part in (errors[:2000], errors[2000:]))
    assert float(known + strange) / 2 == pytest.approx(0.9, abs=0.01)
    plain = fit_density_calibration(logits, errors, BINS)
    same = fit_density_calibration(logits, errors, BINS, weights=torch.ones(2200))
    assert plain == same and plain.central_level != alike.central_level
