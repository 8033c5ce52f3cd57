"""Training on falls that are rendered again at every step, together with clips of data sets if there are any.

Every random number is a function of seed and step. Every report writes the whole state, so that a killed run continues
with the same losses.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from timm.utils import ModelEmaV3
from torch import Tensor

from data_gen import CameraConfig
from models import STATE_SCALE, BinnedDensity, NetworkOutput, PhysicsNetwork, answer_both_ways
from physconvex.io import whole_file
from train.config import TrainConfig
from train.falls.augment import augment_at_once
from train.falls.batches import FallBatch, RealClips, draw_batch, joined_batches, real_batch
from train.falls.world import Falls
from train.losses import density_losses, noisy_states, state_loss
from train.optimisation import optimizer_of
from train.options import Pretraining
from train.progress import Report
from train.run_files import RunLog, TrainingProgress, TrainingState

_LOG = logging.getLogger("physconvex")

STATE = "state.safetensors"
_STEP_SCALE = 1_000_003  # between the seeds of two runs


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
    *,
    out: Path,
    real: RealClips | None = None,
    validation: RealClips | None = None,
    camera: CameraConfig | None = None,
    fingerprint: str = "",
    resume: bool = True,
    report: Report | None = None,
) -> PhysicsNetwork:
    """Train; returns the averaged network with the best score on the validation clips (or the held-out falls).

    Args:
        network: on the device of the falls.
        falls: to train on.
        held_out: falls for evaluation.
        config: network, losses, augmentation, optimiser.
        plan: length and size of the training.
        out: folder of `log.jsonl`, `tensorboard/`, `state.safetensors` and `pretrained.safetensors` (the best so far).
        real: clips of data sets to train on.
        validation: clips of data sets to choose by.
        camera: how views are drawn.
        fingerprint: of everything that affects the numbers; a state with another one is rejected.
        resume: go on from `state.safetensors` where there is one.
        report: called with a name of the work, the number done and the total.

    Raises:
        InputError: `out` holds a run with another fingerprint.
    """
    run = _Run(network, falls, config, plan, out=out, real=real, camera=camera, report=report)
    run.look_at(held_out, validation)
    return run.train(fingerprint, resume)


class _Run:
    def __init__(
        self,
        network: PhysicsNetwork,
        falls: Falls,
        config: TrainConfig,
        plan: Pretraining,
        *,
        out: Path,
        real: RealClips | None,
        camera: CameraConfig | None,
        report: Report | None,
    ) -> None:
        self.network, self.falls, self.real, self.config, self.plan, self.out = network, falls, real, config, plan, out
        self.report: Report = report or (lambda name, done, total: None)
        self.device, self.camera = falls.positions.device, camera or CameraConfig()
        self.confidence = torch.ones(1, device=self.device) if real is None else real.confidence
        self.average = ModelEmaV3(network, decay=config.ema_decay, use_warmup=True)
        self.optimizer, self.schedule = optimizer_of(config, network, plan.steps)
        self.state = TrainingState(out / STATE, network, self.average.module, self.optimizer)
        self.looked_at: dict[str, list[FallBatch]] = {}

    def train(self, fingerprint: str, resume: bool) -> PhysicsNetwork:
        """Run the plan to its end or the budget's."""
        progress = self.state.load(fingerprint, resume=resume)
        log = RunLog(self.out, first_step=progress.step)
        try:
            self._steps(progress, log)
        finally:
            log.close()
        best: PhysicsNetwork = self.average.module
        best.load_state_dict(load_file(self._best))
        return best

    @property
    def _best(self) -> Path:
        return self.out / "pretrained.safetensors"

    def _steps(self, progress: TrainingProgress, log: RunLog) -> None:
        plan, started = self.plan, time.monotonic() - progress.seconds
        sums: dict[str, Tensor] = {}
        since = 0
        while progress.step < plan.steps:
            seconds = time.monotonic() - started
            spent = 0.0 if plan.minutes is None else seconds / (60 * plan.minutes)
            if spent >= 1:
                break
            for name, value in self._update(progress.step, spent).items():
                sums[name] = sums.get(name, 0) + value
            progress, since = replace(progress, step=progress.step + 1, seconds=seconds), since + 1
            self.report("training", progress.step, plan.steps)
            if progress.step % plan.report_steps == 0 or progress.step == plan.steps:
                progress = self._look(progress, log, {name: float(value) / since for name, value in sums.items()})
                sums, since = {}, 0
        if since:  # the budget is spent
            self._look(progress, log, {name: float(value) / since for name, value in sums.items()})

    def _update(self, step: int, spent: float) -> dict[str, Tensor]:
        """One step of the optimiser; the terms of the loss."""
        config, plan, device = self.config, self.plan, self.device
        number = config.seed * _STEP_SCALE + step
        torch.manual_seed(number)  # dropout
        generator = torch.Generator(device).manual_seed(number)
        processor = torch.Generator().manual_seed(number)
        self.schedule.step_update(max(step, int(spent * plan.steps)))
        chosen = torch.randint(len(self.falls), (plan.drawn,), generator=generator, device=device)
        drawn = torch.randint(len(self.confidence), (plan.drawn,), generator=generator, device=device)
        batch = self._drawn(self.falls, chosen, self.confidence[drawn], generator)
        if self.real is not None:
            some = torch.randint(len(self.real), (plan.real,), generator=generator, device=device)
            true = torch.rand(plan.real, generator=generator, device=device) < config.augment.true_moments_share
            batch = joined_batches(batch, real_batch(self.real, some, plan.real_weight, true_moments=true))
        shown = augment_at_once(batch.shown, config.augment, generator)
        clips = replace(batch, shown=shown).clips()
        self.network.train()
        given = noisy_states(shown.states, generator)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            output: NetworkOutput = self.network(clips, states=given, generator=processor)
        material = density_losses(
            output, batch.log10_stiffness, batch.poisson_ratio, config.loss, self.network.config, weight=batch.weight
        )
        states = state_loss(output.states.float(), shown.states, shown.interval, shown.valid)
        self.optimizer.zero_grad(set_to_none=True)
        (material + config.loss.states * states).backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), config.gradient_clip)
        self.optimizer.step()
        self.average.update(self.network, step=step)
        return {"material": material.detach(), "states": states.detach()}

    def _look(self, progress: TrainingProgress, log: RunLog, losses: Mapping[str, float]) -> TrainingProgress:
        """Score the averaged network, keep it if it is the best yet, write the state."""
        network: PhysicsNetwork = self.average.module
        found = {name: scores(network, batches) for name, batches in self.looked_at.items()}
        chosen_by = "real" if "real" in found else "falls"
        score = _score(found[chosen_by], self.looked_at[chosen_by])
        _LOG.info("pretrain: step %d, score %.4f", progress.step, score)
        rate = self.optimizer.param_groups[0]["lr"]
        log.write("train", progress.step, learning_rate=rate, seconds=round(progress.seconds, 1), **losses)
        log.write("validation", progress.step, score=score, **found)
        if progress.best_score is None or score < progress.best_score:
            progress = replace(progress, best_score=score)
            with whole_file(self._best) as partial:
                save_file({name: value.cpu().contiguous() for name, value in network.state_dict().items()}, partial)
        self.state.save(progress)
        return progress

    def look_at(self, held_out: Falls, validation: RealClips | None) -> None:
        """Choose the clips that are scored, always the same."""
        device, generator = self.device, torch.Generator(self.device).manual_seed(self.config.seed)
        sure = self.confidence.mean()
        parts = torch.arange(len(held_out), device=device).split(80)
        self.looked_at["falls"] = [self._drawn(held_out, p, sure.expand(len(p)), generator) for p in parts]
        if validation is not None:
            chosen = torch.arange(len(validation), device=device).split(80)
            self.looked_at["real"] = [real_batch(validation, part, 1.0) for part in chosen]

    def _drawn(self, falls: Falls, chosen: Tensor, confidence: Tensor, generator: torch.Generator) -> FallBatch:
        return draw_batch(falls, chosen, confidence, config=self.config, camera=self.camera, generator=generator)


def _score(found: Mapping[str, float], batches: list[FallBatch]) -> float:
    """CRPS of both relative to no knowledge, as in `train.validation.Validation.score`, without the skinning."""
    stiffness = torch.cat([batch.log10_stiffness for batch in batches])
    poisson = torch.cat([batch.poisson_ratio for batch in batches])
    parts = ((found["log10_stiffness_crps"], stiffness), (found["poisson_crps"], poisson))
    return sum(crps / (float(values.std(correction=0)) + 1e-6) for crps, values in parts)
