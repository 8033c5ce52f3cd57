"""The training loop.

Every random number is a function of seed and step, so that a killed run continues from its last state with the same
losses.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from accelerate import Accelerator
from accelerate.utils import DistributedDataParallelKwargs, broadcast
from timm.utils import ModelEmaV3

from models import PhysicsNetwork, load_checkpoint, load_pretrained_encoder
from physconvex import InputError
from train.config import TrainConfig
from train.data import Plan, PlannedStep, TrainingBatch, batches, split_clips
from train.export import Origin, export_best
from train.losses import compute_losses, noisy_states
from train.optimisation import optimizer_of, precision_for
from train.progress import Report
from train.run_files import RunLog, TrainingProgress, TrainingState, run_fingerprint, write_config
from train.validation import Validation, validate

_LOG = logging.getLogger("physconvex")

_EXAMPLE_SCALE = 1_000_003  # between the seeds of two runs
_SHARES = (0.5, 0.75)  # of the way from a checkpoint to the result of further training


@dataclass(frozen=True)
class TrainingResult:
    """How a run ended."""

    steps: int
    best_score: float | None
    """Of the exported checkpoint; None before the first validation."""
    checkpoint: Path
    """For `PhysicsPredictor.from_pretrained`."""


def train_predictor(
    config: TrainConfig,
    data: Sequence[Path | str],
    out: Path | str,
    *,
    cpu: bool = False,
    resume: bool = True,
    minutes: float | None = None,
    cache: Path | str | None = None,
    report: Report | None = None,
) -> TrainingResult:
    """Train on the `train` split, choose and calibrate on `validation`.

    Args:
        config: the recipe.
        data: data-set folders (docs/reference/data_sets.md).
        out: run folder: `config.json`, `log.jsonl`, `tensorboard/`, `state.safetensors`, `best/`.
        cpu: use no accelerator. Devices and processes are otherwise those of `accelerate launch` or `torchrun`.
        resume: go on from `state.safetensors` where there is one.
        minutes: stop after this time; the learning rate decreases accordingly. The number of steps then depends on the
            machine, so that results are only approximately reproducible.
        cache: where prepared clips live; `out/cache` unless given.
        report: called with a name of the work, the number done and the total.

    Raises:
        InputError: bad data or configuration, or `out` holds a run with another configuration or other data.
    """
    return _Run(config, data, Path(out), cpu=cpu, minutes=minutes, cache=cache, report=report).train(resume=resume)


class _Run:
    def __init__(
        self,
        config: TrainConfig,
        data: Sequence[Path | str],
        out: Path,
        *,
        cpu: bool,
        minutes: float | None,
        cache: Path | str | None,
        report: Report | None,
    ) -> None:
        self.config, self.data, self.out, self.minutes = config, data, out, minutes
        self.report: Report = report or (lambda name, done, total: None)
        # hidden tokens or branches may leave parameters unused
        unused = DistributedDataParallelKwargs(find_unused_parameters=True)
        precision = precision_for(config.mixed_precision, cpu=cpu)
        self.accelerator = Accelerator(cpu=cpu, mixed_precision=precision, kwargs_handlers=[unused])
        self.main = self.accelerator.is_main_process
        self._read_data(Path(cache) if cache else out / "cache")
        self._build()

    def _read_data(self, cache: Path) -> None:
        with self.accelerator.main_process_first():
            self.train_clips, self.validation_clips = (
                split_clips(split, self.config, self.data, cache, workers=self.config.workers, report=self.report)
                for split in ("train", "validation")
            )
        self.plan = Plan.of(self.config, len(self.train_clips), world=self.accelerator.num_processes)

    def _build(self) -> None:
        config = self.config
        torch.manual_seed(config.seed)
        encoder = config.network.encoder
        loaded = None if config.pretrained is None else load_pretrained_encoder(config.pretrained, encoder)
        network = PhysicsNetwork(config.network, encoder=loaded)
        self.start = None if config.checkpoint is None else _starting_point(config).state_dict()
        if self.start is not None:
            network.load_state_dict(self.start)
        self.average = ModelEmaV3(network, decay=config.ema_decay, use_warmup=True)
        self.average.to(self.accelerator.device)
        optimizer, self.schedule = optimizer_of(config, network, self.plan.steps)
        self.model, self.optimizer = self.accelerator.prepare(network, optimizer)
        path = self.out / "state.safetensors"
        self.state = TrainingState(path, self.network, self.average.module, self.optimizer.optimizer)

    @property
    def network(self) -> PhysicsNetwork:
        network = self.accelerator.unwrap_model(self.model)
        assert isinstance(network, PhysicsNetwork)
        return network

    def train(self, *, resume: bool) -> TrainingResult:
        """Run the plan to its end or the budget's."""
        progress = self._start(resume)
        log = RunLog(self.out, first_step=progress.step) if self.main else None
        try:
            progress = self._steps(progress, log)
        finally:
            if log is not None:
                log.close()
        return TrainingResult(progress.step, progress.best_score, self.out / "best")

    def _steps(self, progress: TrainingProgress, log: RunLog | None) -> TrainingProgress:
        started, saved = time.monotonic() - progress.seconds, time.monotonic()
        loader = batches(
            self.train_clips,
            self.plan,
            first_step=progress.step,
            rank=self.accelerator.process_index,
            world=self.accelerator.num_processes,
            workers=self.config.workers,
        )
        while progress.step < self.plan.steps:
            step, seconds = self.plan.step(progress.step), self._agreed(time.monotonic() - started)
            spent = 0.0 if self.minutes is None else seconds / (60 * self.minutes)
            if spent >= 1:
                break
            values = self._update(next(loader), progress.step, spent)
            progress = replace(progress, step=progress.step + 1, seconds=seconds)
            if log is not None:
                log.write("train", progress.step, epoch=step.epoch, **values)
                self.report(f"epoch {step.epoch + 1}", progress.step, self.plan.steps)
            due = (step.epoch + 1) % self.config.validate_every == 0 or progress.step == self.plan.steps
            if step.ends_epoch and due:
                progress = self._validate(progress, step, log)
            if step.ends_epoch or time.monotonic() - saved > self.config.checkpoint_seconds:
                self._save(progress)
                saved = time.monotonic()
        if progress.step < self.plan.steps:  # the budget is spent; the averaged network may have become better
            last = self.plan.step(max(progress.step - 1, 0))
            progress = self._validate(progress, last, log)
            self._save(progress)
        return progress

    def _start(self, resume: bool) -> TrainingProgress:
        """Where to begin; the state is put back."""
        progress = self.state.load(run_fingerprint(self.config, self.data), resume=resume)
        if self.main:
            write_config(self.out, self.config, self.data)
        self.accelerator.wait_for_everyone()
        return progress

    def _agreed(self, seconds: float) -> float:
        """The main process's clock, so that all stop together."""
        if self.minutes is None or self.accelerator.num_processes == 1:
            return seconds
        return float(broadcast(torch.tensor(seconds, device=self.accelerator.device)))

    def _update(self, batch: TrainingBatch, number: int, spent: float) -> dict[str, float]:
        """One step of the optimiser; returns its log entry."""
        config, device = self.config, self.accelerator.device
        rank = self.accelerator.process_index
        torch.manual_seed((config.seed * _EXAMPLE_SCALE + number) * 64 + rank)  # dropout
        generator = torch.Generator().manual_seed((config.seed * _EXAMPLE_SCALE + number) * 64 + rank)
        self.schedule.step_update(max(number, int(spent * self.plan.steps)))
        self.model.train()
        targets = batch.targets.to(device)
        clips = batch.clips.to(device)
        output = self.model(clips, targets.points, states=noisy_states(targets.states, generator), generator=generator)
        losses = compute_losses(output, targets, clips, config.loss, config.network)
        self.optimizer.zero_grad()
        self.accelerator.backward(losses.total)
        norm = self.accelerator.clip_grad_norm_(self.model.parameters(), config.gradient_clip)
        self.optimizer.step()
        self.average.update(self.network, step=number)
        values = {name: value.item() for name, value in vars(losses).items()}
        return values | {"gradient_norm": float(norm), "learning_rate": self.optimizer.param_groups[0]["lr"]}

    def _validate(self, progress: TrainingProgress, step: PlannedStep, log: RunLog | None) -> TrainingProgress:
        """Score the averaged network; export it if it is the best yet."""
        best = progress.best_score
        if log is not None:
            found = validate(self.average.module, self.validation_clips)
            calibration = found.calibration()
            stiffness, poisson = found.metrics(calibration)
            score = found.score()
            log.write(
                "validation",
                progress.step,
                epoch=step.epoch,
                score=score,
                states=found.states,
                span=found.span,
                captured=found.captured,
                stiffness=asdict(stiffness),
                poisson=asdict(poisson),
            )
            _LOG.info("train: step %d, validation score %.4f", progress.step, score)
            if best is None or score < best:
                best = score
                self._export(self.average.module, found)
            if self.start is not None:
                best = self._between(progress, best, log)
        return replace(progress, best_score=best)

    def _between(self, progress: TrainingProgress, best: float, log: RunLog) -> float:
        """Export weights between the checkpoint's and the averaged network's if they are better; return the best score.

        Further training on fewer clips improves on these and forgets earlier ones. Weights in between often combine
        both (Wortsman et al. 2022, Robust fine-tuning of zero-shot models, eq. 2).
        """
        assert self.start is not None
        between, end = deepcopy(self.average.module), self.average.module.state_dict()
        for share in _SHARES:
            weights = {name: value.to(end[name]).lerp(end[name], share) for name, value in self.start.items()}
            between.load_state_dict(weights)
            found = validate(between, self.validation_clips)
            score = found.score()
            log.write("between", progress.step, share=share, score=score)
            if score < best:
                best = score
                self._export(between, found, share=share)
        return best

    def _export(self, network: torch.nn.Module, validation: Validation, *, share: float | None = None) -> None:
        """The best network so far, calibrated."""
        assert isinstance(network, PhysicsNetwork)
        export_best(
            self.out / "best",
            network,
            clips=self.train_clips,
            settings=self.config.clip,
            validation=validation,
            origin=Origin(self.data, self.config.checkpoint, share),
        )

    def _save(self, progress: TrainingProgress) -> None:
        if self.main:
            self.state.save(progress)


def _starting_point(config: TrainConfig) -> PhysicsNetwork:
    """The checkpoint's network, which must have the configured architecture."""
    assert config.checkpoint is not None
    network, found = load_checkpoint(config.checkpoint)
    if found.network != config.network:
        raise InputError(
            f"checkpoint: {config.checkpoint} holds another network than `network` of the configuration; copy the "
            "`network` of its config.json there, or train from scratch"
        )
    if found.clip != config.clip:
        raise InputError(
            f"checkpoint: {config.checkpoint} reads clips prepared as {found.clip}, this configuration prepares them "
            f"as {config.clip}; set `margin` and `extent` to the checkpoint's"
        )
    return network
