"""Time and memory of one training epoch, preparation of the clips apart.

    python benchmarks/training_epoch.py --data data/drops --threads 2

Trains the preset for one epoch in a folder that is thrown away; let nothing else run. Writes
benchmarks/results/training_epoch.json.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from train import load_train_config, train_predictor

RESULT = Path(__file__).parent / "results" / "training_epoch.json"


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """What one epoch took."""

    command: str
    machine: str
    cores: int
    threads: int
    load_before: float
    """Mean number of processes that wanted to run in the last minute."""
    clips: int
    batch_size: int
    prepare_seconds: float
    """Decoding, finding the object, windows: once per data set; 0 where the cache has them."""
    epoch_seconds: float
    clips_per_second: float
    validation_seconds: float
    peak_memory_mib: int
    """Of the training process, the pages of the memory-mapped clips that it read included."""
    worker_peak_memory_mib: int
    """Of the process that augments."""


def main() -> None:
    """Train one epoch, print and store what it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--config", default="default")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--cache", type=Path, default=None, help="of prepared clips; a temporary one unless given")
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    load, started = os.getloadavg()[0], time.monotonic()
    config = load_train_config(options.config, epochs=1)
    steps: list[float] = []

    def report(name: str, done: int, total: int) -> None:
        if name.startswith("epoch"):
            steps.append(time.monotonic())

    with tempfile.TemporaryDirectory() as folder:
        result = train_predictor(
            config, [options.data], Path(folder) / "run", cpu=True, cache=options.cache, report=report
        )
        ended = time.monotonic()
    seconds = (steps[-1] - steps[0]) * result.steps / (result.steps - 1)
    clips = result.steps * config.batch_size
    epoch = Epoch(
        command="python " + " ".join([f"benchmarks/{Path(__file__).name}", *sys.argv[1:]]),
        machine=f"{platform.machine()}, torch {torch.__version__}",
        cores=os.cpu_count() or 1,
        threads=options.threads,
        load_before=round(load, 2),
        clips=clips,
        batch_size=config.batch_size,
        prepare_seconds=round(max(steps[0] - started - seconds / result.steps, 0.0), 1),
        epoch_seconds=round(seconds, 1),
        clips_per_second=round(clips / seconds, 1),
        validation_seconds=round(ended - steps[-1], 1),
        peak_memory_mib=round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        worker_peak_memory_mib=round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024),
    )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(asdict(epoch), indent=1) + "\n", encoding="utf-8")
    print(json.dumps(asdict(epoch), indent=1))


if __name__ == "__main__":
    main()
