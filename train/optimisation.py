"""Optimiser, learning rate and arithmetic of a run."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, Literal

import torch
from timm.optim import create_optimizer_v2
from timm.scheduler import CosineLRScheduler

from train.config import TrainConfig

Precision = Literal["no", "bf16"]


def precision_for(wanted: Precision, *, cpu: bool) -> Precision:
    """`wanted`, but "no" (with a warning) for bf16 on a processor that only emulates it, many times slower.

    Args:
        wanted: of the configuration.
        cpu: no accelerator is to be used.
    """
    if wanted == "no" or not (cpu or not torch.accelerator.is_available()) or _processor_knows_bf16():
        return wanted
    warnings.warn(
        "mixed_precision: this processor does not compute in bf16; the run is in float32", RuntimeWarning, stacklevel=2
    )
    return "no"


def _processor_knows_bf16() -> bool:
    asked = getattr(torch.cpu, "get_capabilities", dict)  # an old torch lacks it: better slow than very slow
    capabilities: Mapping[str, Any] = asked()
    return any(capabilities.get(name, False) for name in ("avx512_bf16", "amx_bf16", "bf16"))


def optimizer_of(
    config: TrainConfig, network: torch.nn.Module, steps: int
) -> tuple[torch.optim.Optimizer, CosineLRScheduler]:
    """The optimiser, and its learning rate by step (`step_update`).

    The rate increases from a hundredth of `config.learning_rate` to all of it, then falls along a cosine to its final
    share.
    """
    optimizer = create_optimizer_v2(
        network, opt=config.optimizer, lr=config.learning_rate, weight_decay=config.weight_decay
    )
    schedule = CosineLRScheduler(
        optimizer,
        t_initial=max(steps, 1),
        lr_min=config.learning_rate * config.final_share,
        warmup_t=round(config.warmup_share * steps),
        warmup_lr_init=config.learning_rate * 0.01,
        t_in_epochs=False,
    )
    return optimizer, schedule
