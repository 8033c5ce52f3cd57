"""Speed of the rasteriser of convexes, on the CPU or on a CUDA device.

A ball covered with 24,000 convexes of six points, drawn at 448²: forward, its two parts (projection with hulls and
lines; blending), forward with backward to all parameters, and the derivatives of all pixels with respect to a few
parameters (a shift, a turn and a stretch of the ball) in forward mode. Each figure is the least of several runs;
wall-clock and processor time [ms]. The blending alone against the limit of the processor: `raster_limit.py`.

On a device, beside Gaussians drawn by `gsplat` where that is installed: as many of them, at the centres of the
convexes, flat, as wide as the convexes are, so that they cover the same area.

python benchmarks/raster_speed.py [--convexes 24000] [--repeats 7] [--threads 2] [--device cuda] [--no-store]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path

import torch

from physconvex.convex import ConvexField, FreeParameters, coefficients_of_colour
from physconvex.io import look_at
from physconvex.numerics import device_named
from physconvex.render import View, render, render_jacobian, splat

RESULTS = Path(__file__).parent / "results"
SIZE = 448


@dataclass(frozen=True)
class Row:
    """One task: least wall-clock and processor time of a run [ms]."""

    task: str
    device: str
    convexes: int
    lines: int
    threads: int
    wall: float
    processor: float


def least(call: Callable[[], object], repeats: int, wait: Callable[[], object] = int) -> tuple[float, float]:
    """Wall-clock and processor time of the fastest run [ms]; `wait` returns when what was begun is done."""
    call()
    found = []
    for _ in range(repeats):
        wait()
        wall, processor = time.perf_counter(), time.process_time()
        call()
        wait()
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


def varied(field: ConvexField, view: View, parameters: torch.Tensor) -> tuple[ConvexField, View]:
    """The field shifted by three parameters [m], turned by three [rad], stretched along x and y by two."""
    x, y, z = field.points.unbind(dim=-1)
    p = torch.cat([parameters, parameters.new_zeros(8 - len(parameters))])
    x, y = x * (1 + p[6]), y * (1 + p[7])
    turned = torch.stack([x - p[5] * y + p[4] * z, y + p[5] * x - p[3] * z, z - p[4] * x + p[3] * y], dim=-1)
    return field.with_points(turned + p[:3]), view


def gaussian_tasks(field: ConvexField, view: View, target: torch.Tensor) -> dict[str, Callable[[], object]]:
    """The same with gsplat; none where it is not installed."""
    try:
        from gsplat import rasterization
    except ImportError:
        print("gsplat is not installed, so there is nothing to compare with")
        return {}
    extent = 2 * torch.linalg.vector_norm(field.points - field.centres[:, None], dim=2).mean(dim=1)
    scales = (extent[:, None] * extent.new_tensor([0.35, 0.35, 0.1])).log()  # 2 σ across, flat
    outward = torch.nn.functional.normalize(field.centres, dim=1)
    turns = torch.nn.functional.normalize(torch.cat([1 + outward[:, 2:], -outward[:, 1:2], outward[:, :1]], 1), dim=1)
    turns = torch.cat([turns, torch.zeros_like(turns[:, :1])], dim=1)  # takes z to the outward direction
    values = (field.centres, turns, scales, field.opacity.logit(), field.harmonics)
    leaves = [value.clone().requires_grad_() for value in values]
    to_camera = torch.eye(4).to(view.rotation)
    to_camera[:3, :3] = (view.rotation * view.rotation.new_tensor([1.0, -1.0, -1.0])).T
    to_camera[:3, 3] = -to_camera[:3, :3] @ view.position
    inner = torch.eye(3).to(view.focal)
    inner[0, 0], inner[1, 1], inner[:2, 2] = view.focal[0], view.focal[1], view.principal

    def draw() -> torch.Tensor:
        centres, quaternions, scale, opacity, colours = leaves
        image: torch.Tensor = rasterization(
            centres, quaternions, scale.exp(), opacity.sigmoid(), colours, to_camera[None], inner[None],
            view.width, view.height, sh_degree=3,
        )[0][0]  # fmt: skip
        return image

    def both() -> None:
        for leaf in leaves:
            leaf.grad = None
        (draw() - target).abs().mean().backward()

    return {"Gaussians by gsplat, forward": torch.no_grad()(draw), "Gaussians by gsplat, forward and backward": both}


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--convexes", type=int, default=24_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--no-store", action="store_true", help="only print")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    device = device_named(options.device)
    backend = "cuda" if device.type == "cuda" else "kernel"
    camera = look_at((0, -2, 0.3), (0, 0, 0), width=SIZE, height=SIZE, vertical_field_of_view=0.6)
    view = View.of(camera, device=device)
    field = covered_ball(options.convexes).to(device)
    free = FreeParameters.of(field)
    target = torch.rand((SIZE, SIZE, 3), generator=torch.Generator().manual_seed(1)).to(device)
    (splats, composite), pixels = splat(field, view, backend=backend), view.pixel_coordinates()

    def forward() -> None:
        with torch.no_grad():
            render(field, view, backend=backend)

    def both() -> None:
        for tensor in free.tensors():
            tensor.grad = None
        (render(free.field(), view, backend=backend).colour - target).abs().mean().backward()

    def jacobian(count: int) -> None:
        render_jacobian(partial(varied, field, view), torch.zeros(count, device=device), backend=backend)

    tasks: dict[str, Callable[[], object]] = {
        "forward": forward,
        "projection alone": lambda: splat(field, view, backend=backend),
        "blending alone": lambda: composite(splats, pixels),
        "forward and backward": both,
        "derivatives by one parameter": lambda: jacobian(1),
        "derivatives by eight parameters": lambda: jacobian(8),
    }
    if device.type == "cuda":
        tasks |= gaussian_tasks(field, view, target)
    wait = torch.cuda.synchronize if device.type == "cuda" else int
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"
    rows = []
    for task, call in tasks.items():
        times = least(call, options.repeats, wait)
        rows.append(Row(task, name, len(splats), len(splats.lines), options.threads, *times))
        print(rows[-1], flush=True)
    assert all(tensor.grad is not None for tensor in free.tensors()), [entry.name for entry in fields(free)]
    if not options.no_store:
        kind = "" if device.type == "cpu" else f"_{device.type}"
        (RESULTS / f"raster_speed{kind}.json").write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
