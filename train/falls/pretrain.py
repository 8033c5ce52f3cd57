"""Training on falls that are drawn anew at every step, beside clips of data sets if there are any."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors.torch import save_file
from timm.utils import ModelEmaV3
from torch import Tensor

from data_gen.config import CameraConfig
from models.heads import BinnedDensity
from models.mirror import answer_both_ways
from models.motion import STATE_SCALE
from models.network import ClipBatch, NetworkOutput, PhysicsNetwork
from train.config import TrainConfig
from train.falls.augment import Shown, augment_at_once
from train.falls.prepare import prepare_clips_at_once
from train.falls.real import RealClips
from train.falls.views import draw_views
from train.falls.world import Falls, turned
from train.losses import density_losses, noisy_states, state_loss

__all__ = ["FallBatch", "Pretraining", "draw_batch", "pretrain", "scores"]

_WARMUP = 0.03


@dataclass(frozen=True)
class Pretraining:
    """How it goes, besides what `TrainConfig` says of network, losses and augmentation."""

    minutes: float = 7.0
    drawn: int = 168
    """Falls of each step."""
    real: int = 24
    """Clips of data sets of each step."""
    real_weight: float = 0.5
    """Of what is said of their material, which few simulations can teach by heart; not of their states."""
    learning_rate: float = 1.2e-3
    weight_decay: float = 0.05
    ema_decay: float = 0.999
    report_seconds: float = 30.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class FallBatch:
    """Clips, labels, and how much each label counts."""

    shown: Shown
    confidence: Tensor
    log10_stiffness: Tensor
    poisson_ratio: Tensor
    weight: Tensor

    def clips(self) -> ClipBatch:
        """As the network reads them."""
        shown = self.shown
        windows = shown.windows.round().clamp(0, 255).byte()
        return ClipBatch(windows, shown.moments, shown.valid, shown.interval, self.confidence)


def draw_batch(
    falls: Falls,
    chosen: Tensor,
    confidence: Tensor,
    config: TrainConfig,
    camera: CameraConfig,
    generator: torch.Generator,
) -> FallBatch:
    """Random views of some falls, prepared as at inference."""
    views = draw_views(falls, chosen, camera, generator)
    prepared = prepare_clips_at_once(views.images, views.masks, config.clip)
    shown = Shown(
        windows=prepared.windows,
        moments=prepared.moments,
        valid=torch.ones(prepared.moments.shape[:2], dtype=torch.bool, device=chosen.device),
        interval=falls.interval[chosen],
        states=turned(falls.states[chosen], views.turn),
    )
    return FallBatch(
        shown, confidence, falls.log10_stiffness[chosen], falls.poisson_ratio[chosen], torch.ones_like(confidence)
    )


def _real_batch(
    real: RealClips, chosen: Tensor, config: TrainConfig, weight: float, generator: torch.Generator
) -> FallBatch:
    draw = torch.rand(len(chosen), generator=generator, device=chosen.device)
    shown = real.shown(chosen, true_moments=draw < config.augment.true_moments_share)
    weights = torch.full_like(draw, weight)
    return FallBatch(shown, real.confidence[chosen], real.log10_stiffness[chosen], real.poisson_ratio[chosen], weights)


def _joined(one: FallBatch, other: FallBatch) -> FallBatch:
    def both(name: str) -> Tensor:
        return torch.cat([getattr(one, name), getattr(other, name)])

    shown = Shown(
        **{name: torch.cat([getattr(one.shown, name), getattr(other.shown, name)]) for name in vars(one.shown)}
    )
    return FallBatch(shown, *(both(name) for name in ("confidence", "log10_stiffness", "poisson_ratio", "weight")))


@torch.no_grad()
def scores(network: PhysicsNetwork, batches: list[FallBatch]) -> dict[str, float]:
    """Mean absolute errors of log10 E and ν, CRPS of both, error of the states, of clips as they are."""
    network.eval()
    columns: list[list[Tensor]] = [[], [], [], [], []]
    for batch in batches:
        with torch.autocast(batch.confidence.device.type, torch.bfloat16, enabled=batch.confidence.is_cuda):
            output = answer_both_ways(network, batch.clips())
        for k, (logits, values, bins) in enumerate(
            (
                (output.stiffness_logits, batch.log10_stiffness, network.config.stiffness),
                (output.poisson_logits, batch.poisson_ratio, network.config.poisson),
            )
        ):
            density = BinnedDensity.from_logits(logits, bins)
            columns[2 * k].append((density.quantile(0.5) - values).abs())
            columns[2 * k + 1].append(density.crps(values))
        error = (output.states.float() - batch.shown.states) / STATE_SCALE.to(values.device)
        columns[4].append(error.abs().mean(dim=(1, 2)))
    names = ("log10_stiffness_mae", "log10_stiffness_crps", "poisson_mae", "poisson_crps", "states")
    return {name: float(torch.cat(column).mean()) for name, column in zip(names, columns, strict=True)}


def pretrain(
    network: PhysicsNetwork,
    falls: Falls,
    held_out: Falls,
    config: TrainConfig,
    plan: Pretraining,
    out: Path,
    *,
    real: RealClips | None = None,
    validation: RealClips | None = None,
    camera: CameraConfig | None = None,
    log: Callable[[str], None] = print,
) -> PhysicsNetwork:
    """Train for so many minutes; the averaged network, whose weights are written to `out` now and then.

    Args:
        network: on the device of the falls.
        falls: to train on.
        held_out: to look at.
        config: network, losses, augmentation.
        plan: how.
        out: folder of `log.jsonl` and `average.safetensors`.
        real: clips of data sets to train on.
        validation: clips of data sets to look at.
        camera: how views are drawn.
        log: told each line of the log.
    """
    device, camera = falls.positions.device, camera or CameraConfig()
    generator = torch.Generator(device).manual_seed(plan.seed)
    processor = torch.Generator().manual_seed(plan.seed)
    confidence = torch.ones(1, device=device) if real is None else real.confidence
    average = ModelEmaV3(network, decay=plan.ema_decay, use_warmup=True)
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=plan.learning_rate, weight_decay=plan.weight_decay, fused=device.type == "cuda"
    )
    looked_at = _looked_at(held_out, validation, confidence, config, camera, generator)
    started = reported = time.monotonic()
    sums: dict[str, Tensor] = {}
    step = since = 0
    with (out / "log.jsonl").open("a", encoding="utf-8") as file:
        while (spent := (time.monotonic() - started) / (60 * plan.minutes)) < 1:
            for group in optimizer.param_groups:
                group["lr"] = plan.learning_rate * _rate(spent)
            chosen = torch.randint(len(falls), (plan.drawn,), generator=generator, device=device)
            drawn = confidence[torch.randint(len(confidence), (plan.drawn,), generator=generator, device=device)]
            batch = draw_batch(falls, chosen, drawn, config, camera, generator)
            if real is not None:
                some = torch.randint(len(real), (plan.real,), generator=generator, device=device)
                batch = _joined(batch, _real_batch(real, some, config, plan.real_weight, generator))
            batch = replace(batch, shown=augment_at_once(batch.shown, config.augment, generator))
            losses = _update(network, optimizer, batch, config, generator, processor)
            average.update(network, step=step)
            sums = {name: sums.get(name, 0) + value for name, value in losses.items()}
            step, since = step + 1, since + 1
            if time.monotonic() - reported > plan.report_seconds:
                line = {name: round(float(value) / since, 4) for name, value in sums.items()}
                found = {name: scores(average.module, batches) for name, batches in looked_at.items()}
                entry = {"step": step, "seconds": round(time.monotonic() - started, 1), **line, **found}
                file.write(json.dumps(entry) + "\n")
                file.flush()
                log(json.dumps(entry))
                _write(average.module, out / "average.safetensors")
                sums, since, reported = {}, 0, time.monotonic()
    _write(average.module, out / "average.safetensors")
    return average.module


def _rate(spent: float) -> float:
    """Of the learning rate: up, and down along a cosine."""
    if spent < _WARMUP:
        return spent / _WARMUP + 0.01
    return 0.005 + 0.995 * 0.5 * (1 + float(torch.tensor(torch.pi * (spent - _WARMUP) / (1 - _WARMUP)).cos()))


def _looked_at(
    held_out: Falls,
    validation: RealClips | None,
    confidence: Tensor,
    config: TrainConfig,
    camera: CameraConfig,
    generator: torch.Generator,
) -> dict[str, list[FallBatch]]:
    device = confidence.device
    parts = torch.arange(len(held_out), device=device).split(80)
    named = {
        "falls": [draw_batch(held_out, p, confidence.mean().expand(len(p)), config, camera, generator) for p in parts]
    }
    if validation is not None:
        chosen = torch.arange(len(validation), device=device).split(80)
        plain = config.model_copy(update={"augment": config.augment.model_copy(update={"true_moments_share": 0.0})})
        named["real"] = [_real_batch(validation, part, plain, 1.0, generator) for part in chosen]
    return named


def _update(
    network: PhysicsNetwork,
    optimizer: torch.optim.Optimizer,
    batch: FallBatch,
    config: TrainConfig,
    generator: torch.Generator,
    processor: torch.Generator,
) -> dict[str, Tensor]:
    """One step of the optimiser; the terms of the loss."""
    network.train()
    shown, clips = batch.shown, batch.clips()
    given = noisy_states(shown.states, generator)
    with torch.autocast(clips.moments.device.type, torch.bfloat16, enabled=clips.moments.is_cuda):
        output: NetworkOutput = network(clips, states=given, generator=processor)
    material = density_losses(
        output, batch.log10_stiffness, batch.poisson_ratio, config.loss, network.config, weight=batch.weight
    )
    states = state_loss(output.states.float(), shown.states, shown.interval, shown.valid)
    optimizer.zero_grad(set_to_none=True)
    (material + config.loss.states * states).backward()
    torch.nn.utils.clip_grad_norm_(network.parameters(), config.gradient_clip)
    optimizer.step()
    return {"material": material.detach(), "states": states.detach()}


def _write(network: torch.nn.Module, path: Path) -> None:
    save_file({name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}, path)
