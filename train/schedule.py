"""The learning rate of a run: up, then down along a cosine."""

from __future__ import annotations

import torch
from timm.scheduler import CosineLRScheduler

from train.config import TrainConfig


def cosine_schedule(optimizer: torch.optim.Optimizer, config: TrainConfig, steps: int) -> CosineLRScheduler:
    """By step (`step_update`): from a hundredth of `config.learning_rate` to all of it, then to its final share."""
    return CosineLRScheduler(
        optimizer,
        t_initial=max(steps, 1),
        lr_min=config.learning_rate * config.final_share,
        warmup_t=round(config.warmup_share * steps),
        warmup_lr_init=config.learning_rate * 0.01,
        t_in_epochs=False,
    )
