"""The rasteriser against the limit of the processor: 64 octagons (512 lines), blended forward at 448².

Nothing but the blending, so that the figure compares with any other implementation of it: random regular octagons of
radius 5 to 20 % of the image, edges two pixels soft. The limit that the kernel is held against is a bare C++ loop
(`raster_limit_kernel/kernel.cpp`) over rows of 16 pixels with the same arithmetic and exact culling, which does
nothing but blend. Beside it the plain torch definition, which culls too. The three take turns, so that they see the
same machine; each figure is the least of several runs; wall-clock and processor time [ms]. One thread.

python benchmarks/raster_limit.py [--repeats 10] [--no-store]
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from raster_speed import SIZE, least

from physconvex.kernels import POINTER, SOURCES, Kernel
from physconvex.render import RENDER_FLAGS, Splats, composite_kernel, composite_reference

RESULT = Path(__file__).parent / "results" / "raster_limit.json"
LOOP = Path(__file__).parent / "raster_limit_kernel"
KERNEL = Kernel(
    LOOP, {"blend_loop": (None, [ctypes.c_int] * 4 + [POINTER] * 6)}, include=[SOURCES / "render"], flags=RENDER_FLAGS
)


@dataclass(frozen=True)
class Row:
    """One implementation: least wall-clock and processor time [ms]; greatest difference of a colour from the
    definition's; processor time over that of the bare loop."""

    implementation: str
    wall: float
    processor: float
    greatest_difference: float
    of_the_loop: float


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


def bare_loop(splats: Splats, pixels: torch.Tensor) -> torch.Tensor:
    """Colours by the bare loop, shape [H, W, 3]; every polygon must have as many sides."""
    image = torch.empty((*pixels.shape[:2], 3))
    arrays = [tensor.contiguous() for tensor in (pixels, *splats.differentiable())]
    sizes = pixels.shape[1], pixels.shape[0], len(splats), len(splats.lines) // len(splats)
    KERNEL.library.blend_loop(*sizes, *(tensor.data_ptr() for tensor in (*arrays, image)))
    return image


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10, help="turns; in each three runs of the two quick ones")
    parser.add_argument("--no-store", action="store_true", help="only print")
    options = parser.parse_args()
    torch.set_num_threads(1)
    splats, pixels = octagons()
    ways: dict[str, tuple[Callable[[Splats, torch.Tensor], torch.Tensor], int]] = {
        "bare loop": (bare_loop, 3),
        "kernel": (lambda splats, pixels: composite_kernel(splats, pixels).features, 3),
        "definition in torch": (lambda splats, pixels: composite_reference(splats, pixels).features, 1),
    }
    truth = composite_reference(splats, pixels).features[..., :3]
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for _ in range(options.repeats):
        for name, (way, repeats) in ways.items():
            times[name].append(least(lambda way=way: way(splats, pixels), repeats))
    processor = {name: min(spent for _, spent in found) for name, found in times.items()}
    rows = []
    for name, (way, _) in ways.items():
        difference = float((way(splats, pixels)[..., :3] - truth).abs().max())
        wall = min(wall for wall, _ in times[name])
        rows.append(Row(name, wall, processor[name], difference, processor[name] / processor["bare loop"]))
        print(rows[-1], flush=True)
    if not options.no_store:
        RESULT.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
