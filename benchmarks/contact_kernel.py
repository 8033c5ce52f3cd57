"""Contact forces by compiled arithmetic and by numpy, on the same drops of the generator, one after the other.

All else is the same: the drops of `contact_solvers.py` with the generator's settings, whose elements are compiled in
both. What moves differently is the order in which numbers are added up.

    python benchmarks/contact_kernel.py
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from contact_solvers import DROPS, scene_of, timed

from physconvex.fem import compiled_contact as contact_kernel
from physconvex.kernels import Kernel

_COMPILED, _NONE = contact_kernel.FEM_KERNEL, Kernel(Path("asked for numpy"), {})
RESULT = Path(__file__).parent / "results" / "contact_kernel.json"


@dataclass(frozen=True)
class Row:
    """One drop: processor seconds either way, the least of the repeats, Newton steps, and how far the motions part."""

    body: str
    nodes: int
    youngs_modulus: float
    numpy_seconds: float
    compiled_seconds: float
    numpy_newton_iterations: int
    compiled_newton_iterations: int
    apart_mm: float


def main() -> None:
    """Run all and store the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=14)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for number, modulus in DROPS:
        rows.append(measured(number, modulus, options.frames, options.repeats))
        print(rows[-1], flush=True)
    content = {
        "command": " ".join(["python", "benchmarks/contact_kernel.py", *sys.argv[1:]]),
        "frames": options.frames,
        "load_average": os.getloadavg()[0],
        "rows": [asdict(row) for row in rows],
    }
    options.out.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def measured(number: int, modulus: float, frames: int, repeats: int) -> Row:
    """One drop, both ways in turn."""
    body, scene, solver = scene_of(number, modulus)
    seconds: dict[str, float] = {}
    runs = {}
    for _ in range(repeats):
        for name, kernel in (("numpy", _NONE), ("compiled", _COMPILED)):
            setattr(contact_kernel, "FEM_KERNEL", kernel)  # noqa: B010 - a constant of the module
            runs[name], (spent, _) = timed(scene, solver, frames)
            seconds[name] = min(spent, seconds.get(name, spent))
    apart = np.sqrt(np.square(runs["numpy"].positions[-1] - runs["compiled"].positions[-1]).sum(-1).mean())
    newton = {name: run.statistics.newton_iterations for name, run in runs.items()}
    return Row(
        body,
        len(scene.start),
        modulus,
        numpy_seconds=seconds["numpy"],
        compiled_seconds=seconds["compiled"],
        numpy_newton_iterations=newton["numpy"],
        compiled_newton_iterations=newton["compiled"],
        apart_mm=round(1e3 * float(apart), 4),
    )


if __name__ == "__main__":
    main()
