"""Speed of the rasteriser of convexes on the CPU.

A ball covered with 24,000 convexes of six points, drawn at 448²: forward, its two parts (projection with hulls and
lines; blending), and forward with backward to all parameters. Each figure is the least of several runs; wall-clock and
processor time [ms]. The blending alone against the limit of the processor: `raster_limit.py`.

python benchmarks/raster_speed.py [--convexes 24000] [--repeats 7] [--threads 2] [--no-store]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import torch

from physconvex.camera import look_at
from physconvex.convex import ConvexField, FreeParameters, coefficients_of_colour
from physconvex.render import View, project, render
from physconvex.render.kernel import composite_kernel
from physconvex.render.rasterize import splat

RESULT = Path(__file__).parent / "results" / "raster_speed.json"
SIZE = 448


@dataclass(frozen=True)
class Row:
    """One task: least wall-clock and processor time of a run [ms]."""

    task: str
    convexes: int
    lines: int
    threads: int
    wall: float
    processor: float


def least(call: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Wall-clock and processor time of the fastest run [ms]."""
    call()
    found = []
    for _ in range(repeats):
        wall, processor = time.perf_counter(), time.process_time()
        call()
        found.append((1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - processor)))
    return min(wall for wall, _ in found), min(processor for _, processor in found)


def covered_ball(count: int, *, radius: float = 0.5, seed: int = 0) -> ConvexField:
    """A ball [m] whose surface is covered with flattish convexes, each as wide as its share of the surface."""
    generator = torch.Generator().manual_seed(seed)
    middle = torch.randn((count, 1, 3), generator=generator)
    middle = middle / middle.norm(dim=-1, keepdim=True)
    width = radius * math.sqrt(4 * math.pi / count)
    offsets = torch.randn((count, 6, 3), generator=generator) * 0.6 * width
    offsets = offsets - 0.7 * (offsets * middle).sum(dim=-1, keepdim=True) * middle
    ones = torch.ones(count)
    harmonics = coefficients_of_colour(0.5 + 0.5 * middle[:, 0])
    harmonics += 0.02 * torch.randn(harmonics.shape, generator=generator)
    return ConvexField(radius * middle + offsets, 8 / width * ones, ones, 0.8 * ones, harmonics)


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--convexes", type=int, default=24_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--no-store", action="store_true", help="only print")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    camera = look_at((0, -2, 0.3), (0, 0, 0), width=SIZE, height=SIZE, vertical_field_of_view=0.6)
    view = View.of(camera)
    field = covered_ball(options.convexes)
    free = FreeParameters.of(field)
    target = torch.rand((SIZE, SIZE, 3), generator=torch.Generator().manual_seed(1))
    splats, pixels = project(field, view), view.pixel_coordinates()

    def forward() -> None:
        with torch.no_grad():
            render(field, view, backend="kernel")

    def both() -> None:
        for tensor in free.tensors():
            tensor.grad = None
        (render(free.field(), view, backend="kernel").colour - target).abs().mean().backward()

    rows = []
    for task, call in (
        ("forward", forward),
        ("projection alone", lambda: splat(field, view, backend="kernel")),
        ("blending alone", lambda: composite_kernel(splats, pixels)),
        ("forward and backward", both),
    ):
        rows.append(Row(task, len(splats), len(splats.lines), options.threads, *least(call, options.repeats)))
        print(rows[-1], flush=True)
    assert all(tensor.grad is not None for tensor in free.tensors()), [entry.name for entry in fields(free)]
    if not options.no_store:
        RESULT.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
