"""From a folder of falls and data sets to a checkpoint: the command `physconvex pretrain`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from data_gen import FallingBody, read_falls
from models import PhysicsNetwork
from physconvex import InputError
from physconvex.numerics import device_named
from train.config import LossConfig, TrainConfig
from train.data import Item, TrainingClips, collate, split_clips
from train.export import Origin, export_best
from train.falls.batches import RealClips
from train.falls.pretrain import STATE, pretrain
from train.falls.world import simulate_falls
from train.losses import Targets, skinning_losses
from train.options import Pretraining
from train.progress import Report
from train.run_files import refuse_other_run, run_fingerprint, write_config
from train.validation import validate

_HELD_OUT = 80  # falls for evaluation only


@dataclass(frozen=True)
class HeadTraining:
    """Training of the skinning head, when all other parts are trained."""

    looks: int = 2
    """At each clip, augmented anew each time."""
    steps: int = 3000
    batch_size: int = 64
    learning_rate: float = 2e-3
    seed: int = 0


def train_on_falls(
    config: TrainConfig,
    plan: Pretraining,
    falls: Path | str,
    data: Sequence[Path | str],
    out: Path | str,
    *,
    device: str = "cuda",
    head: HeadTraining | None = None,
    cache: Path | str | None = None,
    workers: int = 2,
    resume: bool = True,
    report: Report | None = None,
) -> Path:
    """Simulate the falls, train on them and on the data sets' clips, then the skinning head; calibrate; export.

    Args:
        config: network, losses, augmentation.
        plan: of the training on falls.
        falls: folder of `physconvex generate falls`.
        data: data sets, for their clips and their skinning modes; their `validation` objects calibrate.
        out: run folder: `config.json`, `log.jsonl`, `tensorboard/`, `state.safetensors`, `best/`.
        device: a CUDA device; the processor works too, some hundred times slower.
        head: of the training of the skinning head.
        cache: where prepared clips live; `out/cache` unless given.
        workers: processes that prepare clips and bodies.
        resume: continue from `state.safetensors` if it exists; the falls are simulated again.
        report: called with a name of the work, the number done and the total.

    Returns:
        The checkpoint, `out/best`.

    Raises:
        InputError: bad data, too few falls, or `out` holds a run of something else.
    """
    place, out, report = device_named(device), Path(out), report or (lambda name, done, total: None)
    bodies = read_falls(falls)
    if len(bodies) <= _HELD_OUT:
        raise InputError(f"falls: {falls} holds {len(bodies)}; expected more than the {_HELD_OUT} that are held out")
    out.mkdir(parents=True, exist_ok=True)
    mark = _fingerprint(config, plan, Path(falls), data)
    if resume:
        refuse_other_run(out / STATE, mark)
    write_config(out, config, data)
    cache = Path(cache) if cache else out / "cache"
    train, validation = (
        split_clips(split, config, data, cache, workers=workers, report=report) for split in ("train", "validation")
    )
    report("simulating falls", 0, len(bodies))
    frames = config.network.encoder.frames
    held_out, world = (
        simulate_falls(some, device=place, frames=frames, workers=workers)
        for some in (bodies[:_HELD_OUT], bodies[_HELD_OUT:])
    )
    report("simulating falls", len(bodies), len(bodies))
    torch.manual_seed(config.seed)
    network = pretrain(
        PhysicsNetwork(config.network).to(place),
        world,
        held_out,
        config,
        plan,
        out=out,
        real=RealClips.of(train, place),
        validation=RealClips.of(validation, place),
        fingerprint=mark,
        resume=resume,
        report=report,
    ).cpu()
    fit_skinning_head(network, train, config.loss, head, report=report)
    found = validate(network, validation)
    export_best(
        out / "best",
        network,
        clips=train,
        settings=config.clip,
        validation=found,
        origin=Origin(data, beside=_described(bodies[_HELD_OUT:], len(world))),
    )
    return out / "best"


def _fingerprint(config: TrainConfig, plan: Pretraining, falls: Path, data: Sequence[Path | str]) -> str:
    """Hash of everything that affects the numbers of a run, except for its time limit."""
    content = hashlib.sha256(run_fingerprint(config, data).encode())
    content.update(json.dumps(plan.replace(minutes=None).to_json()).encode())
    for path in sorted(falls.glob("falls-[0-9]*.npz")):
        content.update(path.read_bytes())
    return content.hexdigest()


def _described(bodies: Sequence[FallingBody], kept: int) -> str:
    """For the model card."""
    shapes = {hashlib.sha256(body.corners.tobytes()).digest() for body in bodies}
    return (
        f"and, drawn anew at every step, views of {kept} falls of {len(shapes)} shapes, simulated by explicit steps "
        "(`data_gen/explicit`) and drawn plainly (`train/falls`)."
    )


def fit_skinning_head(
    network: PhysicsNetwork,
    clips: TrainingClips,
    loss: LossConfig,
    plan: HeadTraining | None = None,
    *,
    report: Report | None = None,
) -> float:
    """Train only the head, in place, on the network's output for the clips. Returns the last mean loss."""
    plan, report = plan or HeadTraining(), report or (lambda name, done, total: None)
    latents, targets = _latents(network, clips, plan, report)
    head = network.skinning_head
    optimizer = torch.optim.AdamW(head.parameters(), lr=plan.learning_rate, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, plan.learning_rate, total_steps=plan.steps)
    generator = torch.Generator().manual_seed(plan.seed)
    recent = 0.0
    for step in range(plan.steps):
        chosen = torch.randint(len(latents), (plan.batch_size,), generator=generator)
        some = Targets(**{name: value[chosen] for name, value in vars(targets).items()})
        span, captured = (part.mean() for part in skinning_losses(head(latents[chosen], some.points), some))
        total = loss.span * span + loss.captured * captured
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        schedule.step()
        value = float(total.detach())
        recent = 0.98 * recent + 0.02 * value if step else value
        report("skinning head", step + 1, plan.steps)
    return recent


@torch.no_grad()
def _latents(
    network: PhysicsNetwork, clips: TrainingClips, plan: HeadTraining, report: Report
) -> tuple[Tensor, Targets]:
    """Output of the network for every view of every clip, and the targets."""
    network.eval()
    items = [Item(look, clip) for look in range(plan.looks) for clip in range(len(clips))]
    latents, targets = [], []
    for first in range(0, len(items), plan.batch_size):
        batch = collate([clips[item] for item in items[first : first + plan.batch_size]])
        latents.append(network(batch.clips).latent)
        targets.append(batch.targets)
        report("looking at clips", min(first + plan.batch_size, len(items)), len(items))
    merged = {name: torch.cat([getattr(part, name) for part in targets]) for name in vars(targets[0])}
    return torch.cat(latents), Targets(**merged)
