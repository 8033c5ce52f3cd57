"""Time and memory of training on falls: drawing bodies, rolling them out, steps of the training.

    python benchmarks/falls.py --device cuda                                           # the sizes of the recipe
    python benchmarks/falls.py --shapes 2 --falls 4 --drawn 8 --steps 4                # on the processor

Bodies are drawn and meshed on one core, rolled out on the device (`data_gen/explicit`), and views of them trained on
(`physconvex pretrain`, without data sets' clips). Writes benchmarks/results/falls_DEVICE.json.
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

from data_gen import generate_falls, load_config, read_falls
from models import PhysicsNetwork
from train import Pretraining, load_train_config, pretrain, simulate_falls

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True, kw_only=True)
class Took:
    """What it took."""

    command: str
    machine: str
    device: str
    cores: int
    load_before: float
    """Mean number of processes that wanted to run in the last minute."""
    shapes: int
    draw_seconds_per_shape: float
    """Shape, mesh and flights of its falls, on one core."""
    bytes_per_fall: int
    """On disk."""
    falls: int
    stable: int
    lay_out_and_roll_out_seconds: float
    roll_out_memory_mib: int
    drawn: int
    """Falls of a training step."""
    step_seconds: float
    step_memory_mib: int
    """Most that the device held (of the processor: the process), the falls included."""


def main() -> None:
    """Measure, print, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", type=int, default=100, help="that are drawn")
    parser.add_argument("--falls", type=int, default=400, help="of these, that are rolled out")
    parser.add_argument("--drawn", type=int, default=168)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--workers", type=int, default=0, help="processes that lay bodies out")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    config = load_train_config("falls")
    with tempfile.TemporaryDirectory() as work:
        clock = time.perf_counter()
        generate_falls(Path(work) / "falls", shapes=options.shapes, config=load_config("training"), seed=4101)
        draw = (time.perf_counter() - clock) / options.shapes
        files = list((Path(work) / "falls").glob("falls-*.npz"))
        bodies = read_falls(Path(work) / "falls")
        size = sum(path.stat().st_size for path in files) / len(bodies)
        clock = time.perf_counter()
        falls = simulate_falls(bodies[: options.falls], device=options.device, workers=options.workers)
        roll_out, memory = time.perf_counter() - clock, _memory(options.device)
        ticks: list[float] = []
        plan = Pretraining(steps=options.steps, drawn=options.drawn, report_steps=options.steps)
        network = PhysicsNetwork(config.network).to(options.device)

        def tick(name: str, done: int, total: int) -> None:
            _wait(options.device)
            ticks.append(time.perf_counter())

        pretrain(network, falls, falls, config, plan, out=Path(work) / "run", report=tick)
    took = Took(
        command="python " + " ".join([f"benchmarks/{Path(__file__).name}", *sys.argv[1:]]),
        machine=f"{platform.machine()}, torch {torch.__version__}",
        device=torch.cuda.get_device_name(options.device) if options.device.startswith("cuda") else options.device,
        cores=os.cpu_count() or 1,
        load_before=round(load, 2),
        shapes=options.shapes,
        draw_seconds_per_shape=round(draw, 2),
        bytes_per_fall=round(size),
        falls=min(options.falls, len(bodies)),
        stable=len(falls),
        lay_out_and_roll_out_seconds=round(roll_out, 1),
        roll_out_memory_mib=memory,
        drawn=options.drawn,
        step_seconds=round((ticks[-1] - ticks[0]) / (len(ticks) - 1), 3),
        step_memory_mib=_memory(options.device),
    )
    path = RESULTS / f"falls_{options.device.split(':')[0]}.json"
    path.write_text(json.dumps(asdict(took), indent=1) + "\n", encoding="utf-8")
    print(json.dumps(asdict(took), indent=1))


def _wait(device: str) -> None:
    if device.startswith("cuda"):
        torch.cuda.synchronize(device)


def _memory(device: str) -> int:
    if device.startswith("cuda"):
        return round(torch.cuda.max_memory_allocated(device) / 2**20)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


if __name__ == "__main__":
    main()
