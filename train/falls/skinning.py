"""The skinning head of a network whose other parts are already trained."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from models import PhysicsNetwork
from train.config import LossConfig
from train.data import Item, TrainingClips, collate
from train.losses import Targets, skinning_losses
from train.progress import Report


@dataclass(frozen=True)
class HeadTraining:
    """How it goes."""

    looks: int = 2
    """At each clip, augmented anew each time."""
    steps: int = 3000
    batch_size: int = 64
    learning_rate: float = 2e-3
    seed: int = 0


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
