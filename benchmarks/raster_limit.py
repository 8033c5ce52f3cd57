"""The rasteriser against the limit of the processor: 64 octagons (512 lines), blended forward at 448².

Nothing but the blending, so that the figure compares with any other implementation of it: random regular octagons of
radius 5 to 20 % of the image, edges two pixels soft. The limit that the kernel is held against is 14 to 16 ms of
processor time: a bare C++ loop over 16 lanes with a polynomial exponential and exact culling. Beside it the plain torch
definition, which culls too. Each figure is the least of several runs; wall-clock and processor time [ms].

python benchmarks/raster_limit.py [--repeats 30] [--threads 1] [--no-store]
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from raster_speed import SIZE, least

from physconvex.render import Splats
from physconvex.render.kernel import composite_kernel
from physconvex.render.reference import composite_reference

RESULT = Path(__file__).parent / "results" / "raster_limit.json"


@dataclass(frozen=True)
class Row:
    """One implementation: least wall-clock and processor time [ms]; greatest difference from the definition."""

    implementation: str
    threads: int
    wall: float
    processor: float
    greatest_difference: float


def octagons(count: int = 64, *, seed: int = 0) -> tuple[Splats, torch.Tensor]:
    """Random regular octagons, and the coordinates of the pixels (the image is one wide)."""
    generator = torch.Generator().manual_seed(seed)
    middle = torch.rand((count, 1, 2), generator=generator)
    radius = 0.05 + 0.15 * torch.rand((count, 1, 1), generator=generator)
    angle = torch.arange(8) * math.pi / 4 + torch.rand((count, 1), generator=generator)
    normals = torch.stack([angle.cos(), angle.sin()], dim=-1)
    offsets = -(normals * middle).sum(dim=-1, keepdim=True) - radius
    lines = (SIZE * torch.cat([normals, offsets], dim=-1)).flatten(0, 1)
    ones = torch.ones(count)
    features = torch.rand((count, 4), generator=generator)
    splats = Splats(torch.arange(count), torch.arange(count + 1) * 8, lines, 0.5 * ones, 0.5 * ones, features)
    steps = (torch.arange(SIZE) + 0.5) / SIZE
    return splats, torch.stack(torch.meshgrid(steps, steps, indexing="xy"), dim=-1)


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=30, help="runs of the kernel; a fifth of them of the definition")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--no-store", action="store_true", help="only print")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    splats, pixels = octagons()
    truth = composite_reference(splats, pixels).features
    rows = []
    for name, composite, repeats in (
        ("kernel", composite_kernel, options.repeats),
        ("definition in torch", composite_reference, max(1, options.repeats // 5)),
    ):
        difference = float((composite(splats, pixels).features - truth).abs().max())
        times = least(lambda composite=composite: composite(splats, pixels), repeats)
        rows.append(Row(name, options.threads, *times, difference))
        print(rows[-1], flush=True)
    if not options.no_store:
        RESULT.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
