"""How well E and ν could be read if the motion were seen perfectly, or with a given error.

The part of the network that reads the material from states of the motion (`models.motion`) is trained on the true
states of a data set's simulations, with noise of each level, and measured on held-out objects: what seeing costs is the
rest. One row per noise level, in typical magnitudes of each state (`models.motion.STATE_SCALE`), beside the constant.

    python benchmarks/known_states.py --data data/drops
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from timm.layers import Mlp
from torch import Tensor, nn

from models import (
    STATE_NAMES,
    STATE_SCALE,
    BinnedDensity,
    DensityHead,
    MotionBranch,
    NetworkConfig,
    dimensionless_interval,
    log10_dimensionless_stiffness,
)
from train import LabelledClip, Split, read_clips, smoothed_target

RESULT = Path(__file__).parent / "results" / "known_states.json"
BATCH = 64


class Reader(nn.Module):
    """States -> logits of both densities."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.motion, size = MotionBranch(config.kinematics), config.latent_size
        self.channels = config.kinematics.channels
        self.norm = nn.LayerNorm(self.motion.out_features)
        self.join = Mlp(self.motion.out_features + 1, 2 * size, size, drop=config.dropout)
        self.stiffness = DensityHead(size, config.stiffness, dropout=config.dropout)
        self.poisson = DensityHead(size, config.poisson, dropout=config.dropout)

    def forward(self, states: Tensor, interval: Tensor) -> tuple[Tensor, Tensor]:
        count, frames = states.shape[:2]
        every = torch.ones(count, dtype=torch.bool)
        motion = self.motion(
            states.new_zeros(count, frames, self.channels),
            interval,
            torch.ones(count, frames, dtype=torch.bool),
            given=states,
            use_given=every,
            hide_features=every,
        )
        latent = self.join(torch.cat([self.norm(motion.embedding), interval.log2()[:, None] + 3], dim=-1))
        return self.stiffness(latent), self.poisson(latent)


def labels_of(clips: Sequence[LabelledClip]) -> tuple[np.ndarray, ...]:
    """States, dimensionless intervals, log10 E/(ρ g L), ν."""
    size, modulus, density = (
        np.array([getattr(clip, name) for clip in clips]) for name in ("object_size", "youngs_modulus", "density")
    )
    return (
        np.stack([clip.samples.states() for clip in clips]),
        dimensionless_interval(np.array([clip.fps for clip in clips]), object_size=size),
        log10_dimensionless_stiffness(modulus, density=density, object_size=size),
        np.array([clip.poisson_ratio for clip in clips]),
    )


def read(data: list[Path], split: Split) -> tuple[Tensor, ...]:
    """The same of every view of every simulation of a split."""
    return tuple(torch.tensor(column, dtype=torch.float32) for column in labels_of(read_clips(data, split)))


def measure(
    training: tuple[Tensor, ...], held_out: tuple[Tensor, ...], noise: float, steps: int
) -> tuple[float, float]:
    """Mean absolute errors of log10 E and ν."""
    config = NetworkConfig()
    torch.manual_seed(0)
    reader = Reader(config)
    optimizer = torch.optim.AdamW(reader.parameters(), lr=1e-3, weight_decay=0.1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1e-3, steps)
    states, interval, stiffness, poisson = training
    for _ in range(steps):
        chosen = torch.randint(0, len(states), (BATCH,))
        shown = states[chosen] + noise * STATE_SCALE * torch.randn(BATCH, *states.shape[1:])
        logits = reader(shown, interval[chosen])
        parts = ((logits[0], stiffness[chosen], config.stiffness), (logits[1], poisson[chosen], config.poisson))
        loss = sum(-(smoothed_target(y, bins, 1.5) * x.log_softmax(-1)).sum(-1).mean() for x, y, bins in parts)
        optimizer.zero_grad()
        torch.as_tensor(loss).backward()
        optimizer.step()
        schedule.step()
    reader.eval()
    states, interval, stiffness, poisson = held_out
    shown = states + noise * STATE_SCALE * torch.randn(states.shape)
    with torch.no_grad():
        logits = reader(shown, interval)
    return (
        _error(stiffness, BinnedDensity.from_logits(logits[0], config.stiffness)),
        _error(poisson, BinnedDensity.from_logits(logits[1], config.poisson)),
    )


def _error(truth: Tensor, density: BinnedDensity) -> float:
    return float((density.quantile(0.5) - truth).abs().mean())


def main() -> None:
    """Train, measure, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, action="append", required=True)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.03, 0.1, 0.3])
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    training, held_out = read(options.data, "train"), read(options.data, "test")
    constant = [float((y - x.median()).abs().mean()) for x, y in zip(training[2:], held_out[2:], strict=True)]
    rows = [{"noise": None, "mae_log10_stiffness": constant[0], "mae_poisson_ratio": constant[1]}]
    print(f"{'noise':>10}{'MAE log10 E':>13}{'MAE nu':>9}\n{'constant':>10}{constant[0]:13.3f}{constant[1]:9.4f}")
    for noise in options.noise:
        found = measure(training, held_out, noise, options.steps)
        rows.append({"noise": noise, "mae_log10_stiffness": found[0], "mae_poisson_ratio": found[1]})
        print(f"{noise:10.2f}{found[0]:13.3f}{found[1]:9.4f}", flush=True)
    tree = {
        "command": "python " + " ".join([f"benchmarks/{Path(__file__).name}", *sys.argv[1:]]),
        "states": STATE_NAMES,
        "clips": {"train": len(training[0]), "test": len(held_out[0])},
        "rows": rows,
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
