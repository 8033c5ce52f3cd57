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
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from models.estimator import PhysicsPredictor
from models.heads import BinnedDensity
from models.motion import STATE_SCALE
from models.network import ClipBatch, PhysicsNetwork
from train.cache import prepare_clips
from train.data import TrainingClips
from train.metrics import constant_mae
from train.records import read_clips

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
    clips = TrainingClips(labelled, prepared, augmentation=None, modes=1, seed=0)
    modulus = np.array([clip.youngs_modulus for clip in labelled])
    network = predictor.network.eval()
    readings = [
        read(network, clips, modulus, "as found", silhouettes=0),
        read(network, clips, modulus, "true silhouettes", silhouettes=1),
        read(network, clips, modulus, "true states", silhouettes=0, told=True),
    ]
    constant = {
        "log10_stiffness_mae": constant_mae(clips.log10_stiffness),
        "poisson_mae": constant_mae(clips.poisson_ratio),
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


def read(
    network: PhysicsNetwork, clips: TrainingClips, modulus: Values, name: str, *, silhouettes: int, told: bool = False
) -> Reading:
    """What the network says of all clips.

    Args:
        network: in evaluation mode.
        clips: unaugmented.
        modulus: of each [Pa].
        name: of this way of reading.
        silhouettes: 0 measured in the masks found, 1 in the true ones.
        told: the true states stand in for those seen.
    """
    states = torch.from_numpy(np.stack(clips.states))
    hook = network.motion.register_forward_pre_hook(_tell_all, with_kwargs=True) if told else None
    stiffness, poisson, seen = [], [], []
    with torch.no_grad():
        for first in range(0, len(clips), BATCH):
            some = slice(first, first + BATCH)
            output = network(_batch(clips, some, silhouettes), states=states[some])
            stiffness.append(BinnedDensity.from_logits(output.stiffness_logits, network.config.stiffness).quantile(0.5))
            poisson.append(BinnedDensity.from_logits(output.poisson_logits, network.config.poisson).quantile(0.5))
            seen.append(((output.states - states[some]) / STATE_SCALE).abs().mean(dim=(1, 2)))
    if hook is not None:
        hook.remove()
    errors = (
        torch.cat(stiffness).double().numpy() - clips.log10_stiffness,
        torch.cat(poisson).double().numpy() - clips.poisson_ratio,
        None if told else torch.cat(seen).double().numpy(),
    )
    decade = np.floor(np.log10(modulus)).astype(int)
    decades = {f"1e{k}": _told(errors, decade == k) for k in sorted(set(decade.tolist()))}
    return Reading(name, _told(errors, np.ones(len(clips), bool)), decades)


def _tell_all(module: Any, arguments: tuple[Any, ...], named: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Of every clip the motion branch reads the states that it is given."""
    return arguments, named | {"use_given": torch.ones(len(named["given"]), dtype=torch.bool)}


def _batch(clips: TrainingClips, some: slice, silhouettes: int) -> ClipBatch:
    prepared = clips.prepared

    def send(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.array(values))

    return ClipBatch(
        windows=send(prepared.windows[some]),
        moments=send(prepared.moments[some, silhouettes]),
        valid=send(prepared.valid[some]),
        interval=send(clips.interval[some]).float(),
        confidence=send(prepared.confidence[some]),
    )


def _told(errors: Sequence[Values | None], chosen: np.ndarray) -> Told:
    stiffness, poisson, states = errors
    assert stiffness is not None and poisson is not None
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
