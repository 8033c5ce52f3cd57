"""Where the time of a refinement goes: seconds and roll-outs of the full model, stage by stage, of a bundled capture.

python benchmarks/refine_time.py --capture examples/captures/school_bus

Everything `physconvex refine` does is made anew, convex field included, but for the files it writes. A stage's seconds
last until the next one begins. Beside the clock stands the processor time of all threads, that of other processes in
the last stage and in the sum: where it is well below what the clock says times the cores used, the machine was shared.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does, before numpy is loaded

import torch

from inference import Refinement, RefineOptions, refine
from physconvex.identify import RollOut, RollOuts
from physconvex.numerics import device_named

RESULT = Path(__file__).parent / "results" / "refine_time.json"
TRUTHS = {"school_bus": {"log10_youngs_modulus": 5.3, "poisson_ratio": 0.4, "damping_time": 1e-3}}


@dataclass
class Stage:
    """Seconds by the clock and of this process until the next stage begins; roll-outs by nodes and steps."""

    name: str
    wall_seconds: float = 0.0
    process_seconds: float = 0.0
    roll_outs: dict[str, int] = field(default_factory=dict)
    roll_out_seconds: float = 0.0


class Watch:
    """Told of each stage, it notes what the one before has cost."""

    def __init__(self) -> None:
        self.stages = [Stage("set-up")]
        self._began = (time.perf_counter(), _processor())

    def __call__(self, name: str, _read: bool) -> None:
        """A stage begins."""
        self.close()
        print(json.dumps(asdict(self.stages[-1])), flush=True)
        self.stages.append(Stage(name))

    def close(self) -> None:
        """The last stage ends."""
        now = (time.perf_counter(), _processor())
        stage = self.stages[-1]
        stage.wall_seconds, stage.process_seconds = (round(b - a, 1) for a, b in zip(self._began, now, strict=True))
        stage.roll_out_seconds = round(stage.roll_out_seconds, 1)
        self._began = now

    def counted(self, run: Any) -> Any:
        """The memory's method that makes roll-outs, these counted."""

        def counting(memory: RollOuts, jobs: Sequence[RollOut]) -> Any:
            stage = self.stages[-1]
            for job in jobs:
                kind = f"{len(job.scene.body.mesh.vertices)} nodes, "
                kind += f"{job.timing['frames']} x {job.timing['steps_per_frame']} steps"
                stage.roll_outs[kind] = stage.roll_outs.get(kind, 0) + 1
            clock = time.perf_counter()
            try:
                return run(memory, jobs)
            finally:
                stage.roll_out_seconds += time.perf_counter() - clock

        return counting


def _processor() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _card(device: str) -> str:
    place = device_named(device)
    return f", {torch.cuda.get_device_name(place)}" if place.type == "cuda" else ""


def row_of(found: Refinement, truth: dict[str, float], watch: Watch) -> dict[str, Any]:
    """What is stored."""
    rolled: Counter[str] = sum((Counter(stage.roll_outs) for stage in watch.stages), Counter())
    return {
        "wall_seconds": round(sum(stage.wall_seconds for stage in watch.stages), 1),
        "process_seconds": round(sum(stage.process_seconds for stage in watch.stages), 1),
        "roll_outs": dict(rolled),
        "roll_outs_in_all": sum(rolled.values()),
        "error": {e.name: e.value - truth[e.name] for e in found.estimates if e.name in truth},
        "interval_90": {e.name: e.interval for e in found.estimates},
        "residual_rms": found.residual_rms,
        "in_words": [*found.identifiability.sentences, *found.warnings],
        "stages": [asdict(stage) for stage in watch.stages],
    }


def main() -> None:
    """Refine, and store the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--capture", type=Path, default=Path("examples/captures/school_bus"))
    parser.add_argument("--processes", type=int, default=1, help="roll-outs made at once")
    parser.add_argument("--threads", type=int, default=1, help="of torch")
    parser.add_argument("--device", default="cpu", help="of the network and the field's fit")
    parser.add_argument("--note", default="", help="what else the machine did")
    parser.add_argument("--result", type=Path, default=RESULT)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    watch = Watch()
    RollOuts._made = watch.counted(RollOuts._made)  # type: ignore[method-assign]
    with tempfile.TemporaryDirectory() as out:
        options = RefineOptions(processes=given.processes, device=given.device)
        found = refine(given.capture, out=out, options=options, on_stage=watch)
    watch.close()
    content = {
        "command": f"python benchmarks/refine_time.py --capture {given.capture} --processes {given.processes} "
        f"--threads {given.threads} --device {given.device}",
        "machine": f"{os.cpu_count()} cores, {platform.machine()}{_card(given.device)}; "
        f"{given.note or 'nothing else ran'}",
    }
    content |= row_of(found, TRUTHS.get(given.capture.name, {}), watch)
    given.result.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
