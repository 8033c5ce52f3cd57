"""Where a predictor's error comes from: clips as found, with the silhouettes measured in true masks, with true states.

    python benchmarks/error_budget.py --data data/drops --checkpoint default

On the validation clips of data sets, each read once (`predict` also reads its mirror image): as they are; with the
measures of the true silhouettes in the place of those found; with the true states of the motion (`models.motion`)
in the place of those that the network sees, beside what else it saw. Also the constant predictor, and the errors by
decade of E. What is left with true states no better seeing takes away.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from models import STATE_SCALE, BinnedDensity, PhysicsNetwork, PhysicsPredictor
from train import FallBatch, RealClips, TrainingClips, constant_mae, prepare_clips, read_clips

RESULT = Path(__file__).parent / "results" / "error_budget.json"
BATCH = 20

Values = Float64[np.ndarray, " N"]


@dataclass(frozen=True)
class Told:
    """Mean absolute errors and biases of clips read in one way."""

    clips: int
    log10_stiffness_mae: float
    log10_stiffness_bias: float
    poisson_mae: float
    poisson_bias: float
    states: float | None
    """Error of the states, in typical magnitudes."""


@dataclass(frozen=True)
class Reading:
    """All clips, and those of each decade of E [Pa]."""

    name: str
    all: Told
    decades: dict[str, Told]


def main() -> None:
    """Measure, print, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, nargs="+", required=True)
    parser.add_argument("--checkpoint", default="default")
    parser.add_argument("--cache", type=Path, default=Path("runs/error_budget"))
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    predictor = PhysicsPredictor.from_pretrained(options.checkpoint)
    labelled = read_clips(options.data, "validation")
    prepared = prepare_clips(labelled, predictor.config.clip, options.cache)
    clips = RealClips.of(TrainingClips(labelled, prepared, augmentation=None, modes=1, seed=0), "cpu")
    modulus = np.array([clip.youngs_modulus for clip in labelled])
    network = predictor.network.eval()
    readings = [
        read(network, clips, modulus, "as found"),
        read(network, clips, modulus, "true silhouettes", true_moments=True),
        read(network, clips, modulus, "true states", told=True),
    ]
    constant = {
        "log10_stiffness_mae": constant_mae(clips.log10_stiffness.numpy()),
        "poisson_mae": constant_mae(clips.poisson_ratio.numpy()),
    }
    for reading in readings:
        print(f"{reading.name:18}{_row(reading.all)}   " + "  ".join(map(_row, reading.decades.values())))
    print(f"{'constant':18}{constant['log10_stiffness_mae']:.3f} / {constant['poisson_mae']:.4f}")
    options.out.write_text(
        json.dumps(
            {
                "command": "python " + " ".join(["benchmarks/error_budget.py", *sys.argv[1:]]),
                "constant": constant,
                "readings": [asdict(reading) for reading in readings],
            },
            indent=1,
        )
        + "\n"
    )


@torch.no_grad()
def read(
    network: PhysicsNetwork,
    clips: RealClips,
    modulus: Values,
    name: str,
    *,
    true_moments: bool = False,
    told: bool = False,
) -> Reading:
    """What the network says of all clips.

    Args:
        network: in evaluation mode.
        clips: as they are.
        modulus: of each [Pa].
        name: of this way of reading.
        true_moments: silhouettes measured in the true masks, not in those found.
        told: the true states stand in for those seen.
    """
    hook = network.motion.register_forward_pre_hook(_tell_all, with_kwargs=True) if told else None
    parts: list[tuple[torch.Tensor, ...]] = []
    for chosen in torch.arange(len(clips)).split(BATCH):
        shown = clips.shown(chosen, true_moments=torch.full_like(chosen, true_moments, dtype=torch.bool))
        truth = (clips.log10_stiffness[chosen], clips.poisson_ratio[chosen])
        batch = FallBatch(shown, clips.confidence[chosen], *truth, torch.ones(len(chosen)))
        output = network(batch.clips(), states=shown.states)
        stiffness = BinnedDensity.from_logits(output.stiffness_logits, network.config.stiffness).quantile(0.5)
        poisson = BinnedDensity.from_logits(output.poisson_logits, network.config.poisson).quantile(0.5)
        seen = ((output.states - shown.states) / STATE_SCALE).abs().mean(dim=(1, 2))
        parts.append((stiffness - truth[0], poisson - truth[1], seen))
    if hook is not None:
        hook.remove()
    columns = [torch.cat(column).double().numpy() for column in zip(*parts, strict=True)]
    errors = (columns[0], columns[1], None if told else columns[2])
    decade = np.floor(np.log10(modulus)).astype(int)
    decades = {f"1e{k}": _told(errors, decade == k) for k in sorted(set(decade.tolist()))}
    return Reading(name, _told(errors, np.ones(len(clips), bool)), decades)


def _tell_all(module: Any, arguments: tuple[Any, ...], named: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Of every clip the motion branch reads the states that it is given."""
    return arguments, named | {"use_given": torch.ones(len(named["given"]), dtype=torch.bool)}


def _told(errors: tuple[Values, Values, Values | None], chosen: np.ndarray) -> Told:
    stiffness, poisson, states = errors
    return Told(
        clips=int(chosen.sum()),
        log10_stiffness_mae=float(np.abs(stiffness[chosen]).mean()),
        log10_stiffness_bias=float(stiffness[chosen].mean()),
        poisson_mae=float(np.abs(poisson[chosen]).mean()),
        poisson_bias=float(poisson[chosen].mean()),
        states=None if states is None else float(states[chosen].mean()),
    )


def _row(told: Told) -> str:
    seen = "" if told.states is None else f" states {told.states:.3f}"
    return f"{told.log10_stiffness_mae:.3f} / {told.poisson_mae:.4f}{seen} ({told.clips})"


if __name__ == "__main__":
    main()
