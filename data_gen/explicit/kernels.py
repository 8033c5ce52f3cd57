"""The kernels of `gpu/` as functions of torch tensors: on a CUDA device by NVRTC, elsewhere by the C++ compiler."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from jaxtyping import Float32, Int32
from torch import Tensor

from data_gen.explicit.bodies import Layout
from physconvex.kernels import POINTER, SOURCES, Kernel, launch

VIEW = 16  # numbers of a view, as in gpu/draw.h
LOOK = 40  # numbers of a look
_HERE = Path(__file__).parent / "gpu"
_SHARED = SOURCES / "shared"
_DRAWING = (_HERE / "draw.h", _HERE / "draw.cu")
_TEXTS = {
    "roll_out": (_SHARED / "neo_hookean.h", _HERE / "body.h", _HERE / "kernel.cu"),
    "nearest": _DRAWING,
    "resolve": _DRAWING,
}
_KERNEL = Kernel(
    _HERE,
    {
        "roll_out": (None, [ctypes.c_int, *[POINTER] * 10, ctypes.c_int]),
        "draw": (None, [ctypes.c_int, *[POINTER] * 7, *[ctypes.c_int] * 3]),
    },
    include=[_SHARED],
)
_THREADS = 256


def roll_out(layout: Layout, device: torch.device | str = "cpu") -> Float32[Tensor, " T"]:
    """Positions of all bodies at all frames, as `Layout.positions` splits them [m].

    A body that became unstable has values that are not finite.

    Raises:
        KernelUnavailable: neither a CUDA device that can be compiled for nor a C++ compiler.
    """
    names = ("table", "materials", "coefficients", "geometry", "corners", "incident", "begin", "nodes", "start", "out")
    tensors = {name: torch.from_numpy(getattr(layout, name)).to(device, copy=True) for name in names}
    start, out = tensors["start"], tensors["out"]
    if out.device.type != "cuda":
        addresses = [tensors[name].data_ptr() for name in names]
        _KERNEL.library.roll_out(len(layout.table), *addresses, layout.frames)
        return out
    work = torch.empty(18 * len(start), device=device)
    forces = torch.empty(30 * len(layout.geometry), device=device)
    given = [tensors[name] for name in names[:8]]
    _launch("roll_out", len(layout.table), [*given, start, work, forces, out, layout.frames])
    return out


@dataclass(frozen=True)
class DrawnClips:
    """Inputs for the rendering of some clips.

    Attributes:
        clips: first node of the body, its nodes, first triangle, its triangles.
        views: see gpu/draw.h; their last number is the number of samples per pixel and axis.
        looks: see gpu/draw.h.
        positions: of all bodies, from `roll_out`.
        rest: where the colours are fixed to the nodes, in sizes.
        triangles: of all bodies, each counting its own nodes.
    """

    clips: Int32[Tensor, "B 4"]
    views: Float32[Tensor, "B T 16"]
    looks: Float32[Tensor, "B 40"]
    positions: Float32[Tensor, " P"]
    rest: Float32[Tensor, "N 3"]
    triangles: Int32[Tensor, "F 3"]


def render_falls(batch: DrawnClips, *, side: int, factor: int = 2) -> Float32[Tensor, "B T S S 4"]:
    """Colours and coverage (0..255, 0..1) of every frame of some clips.

    Args:
        batch: the clips.
        side: of the picture [px].
        factor: samples per pixel and axis.
    """
    count, frames = batch.views.shape[:2]
    device = batch.positions.device
    pictures = torch.empty((count, frames, side, side, 4), device=device)
    given = (batch.clips, batch.views, batch.looks, batch.positions, batch.rest, batch.triangles)
    tensors = clips, views, looks, positions, rest, triangles = [tensor.contiguous() for tensor in given]
    if device.type != "cuda":
        addresses = [tensor.data_ptr() for tensor in (*tensors, pictures)]
        _KERNEL.library.draw(count, *addresses, frames, side * factor, factor)
        return pictures
    samples = torch.full((count * frames, side * factor, side * factor), -1, dtype=torch.int64, device=device)
    _launch("nearest", count * frames, [clips, views, positions, triangles, samples, frames, side * factor])
    seen = [clips, views, looks, positions, rest, triangles, samples, pictures]
    _launch("resolve", count * frames, [*seen, frames, side * factor, factor])
    return pictures


@cache
def kernel_source(name: str) -> str:
    """The CUDA text of one of the kernels."""
    texts = [part.read_text(encoding="utf-8") for part in _TEXTS[name]]
    defined = "#define DEVICE __device__ __forceinline__\n#define bits_of __float_as_uint\n"
    return defined + "".join(texts)


def _launch(name: str, blocks: int, arguments: Sequence[Tensor | int]) -> None:
    launch(kernel_source(name), name, grid=(blocks, 1), threads=_THREADS, arguments=arguments)
