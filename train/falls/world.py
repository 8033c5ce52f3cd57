"""Simulated falls on one device: positions, surfaces and the true states of the motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, Int32
from torch import Tensor

from data_gen import FPS, FallingBody, Layout, lay_out, roll_out
from models import dimensionless_interval, log10_dimensionless_stiffness
from physconvex import ConvergenceError
from physconvex.mesh import QUADRATURE, shape_values

Index = Int[Tensor, " B"]
"""Numbers of falls."""

_OUTERMOST = 0.01  # as in train.motion_states
_FARTHEST = 20.0  # [m]
_CAUTION = 3.0  # with those that became unstable
_SHAPES = torch.from_numpy(shape_values(QUADRATURE[2][0], 2)).float()  # at the points of an element


@dataclass(frozen=True, eq=False)
class Falls:
    """N falls of T frames; bodies one behind the other, as in `data_gen.explicit.bodies.Layout`."""

    clips: Int32[Tensor, "N 4"]
    """First node, nodes, first triangle, triangles."""
    positions: Float32[Tensor, " P"]
    """[m]"""
    rest: Float32[Tensor, "V 3"]
    """Where colours are fixed: at the start, in sizes."""
    triangles: Int32[Tensor, "F 3"]
    states: Float32[Tensor, "N T S"]
    """Seen along y (`models.motion.STATE_NAMES`)."""
    size: Float32[Tensor, " N"]
    """[m]"""
    log10_stiffness: Float32[Tensor, " N"]
    poisson_ratio: Float32[Tensor, " N"]
    interval: Float32[Tensor, " N"]
    """Δt √(g/L)."""
    frames: int

    def __len__(self) -> int:
        return len(self.clips)

    def body(self, number: int) -> Float32[Tensor, "T V 3"]:
        """Positions of one body [m]."""
        node, count = (int(v) for v in self.clips[number, :2])
        return self.positions[3 * node * self.frames :][: 3 * count * self.frames].view(self.frames, count, 3)


def simulate_falls(
    bodies: Sequence[FallingBody],
    *,
    device: torch.device | str = "cpu",
    frames: int = 24,
    workers: int = 0,
) -> Falls:
    """Roll all of them out; unstable ones are repeated with shorter steps, and left out if still unstable.

    Args:
        bodies: the bodies.
        device: the device.
        frames: of each fall.
        workers: processes that prepare them; 0 does so in this one.

    Raises:
        ConvergenceError: none is stable.
    """
    parts = [_simulated(bodies, device, frames, workers, 1.0)]
    lost = [body for body, ok in zip(parts[0].bodies, parts[0].sound, strict=True) if not ok]
    if lost:
        parts.append(_simulated(lost, device, frames, workers, _CAUTION))
    sound = [part for part in parts if any(part.sound)]
    if not sound:
        raise ConvergenceError(f"none of {len(bodies)} falls stayed stable")
    return joined([_falls(part) for part in sound])


@dataclass(frozen=True, eq=False)
class _Simulated:
    """Bodies in the order of their layout, their positions, and which of them are stable."""

    bodies: list[FallingBody]
    layout: Layout
    positions: Tensor
    sound: list[bool]


def _simulated(
    bodies: Sequence[FallingBody], device: torch.device | str, frames: int, workers: int, caution: float
) -> _Simulated:
    longest_first = sorted(bodies, key=lambda body: -body.stiffest * body.damping_time)
    layout = lay_out(longest_first, frames=frames, workers=workers, caution=caution)
    positions = roll_out(layout, device)
    within = [bool((layout.positions(positions, k).abs() < _FARTHEST).all()) for k in range(len(bodies))]
    return _Simulated(longest_first, layout, positions, within)


def joined(parts: Sequence[Falls]) -> Falls:
    """All falls of some worlds in one."""
    rows, node, triangle = [], 0, 0
    for part in parts:
        offset = torch.tensor([node, 0, triangle, 0], dtype=torch.int32, device=part.clips.device)
        rows.append(part.clips + offset)
        node, triangle = node + len(part.rest), triangle + len(part.triangles)
    names = ("positions", "rest", "triangles", "states", "size", "log10_stiffness", "poisson_ratio", "interval")
    merged = {name: torch.cat([getattr(part, name) for part in parts]) for name in names}
    return Falls(clips=torch.cat(rows), frames=parts[0].frames, **merged)


def _falls(part: _Simulated) -> Falls:
    layout, positions = part.layout, part.positions
    kept = [k for k, ok in enumerate(part.sound) if ok]
    bodies = [part.bodies[k] for k in kept]
    counts = [len(triangles) for triangles in layout.boundary]
    first = np.cumsum([0, *counts])
    rows = [(*layout.table[k, :2], first[k], counts[k]) for k in kept]
    size = np.array([body.size for body in bodies])
    modulus, density = (np.array([getattr(b, name) for b in bodies]) for name in ("youngs_modulus", "density"))
    rest = np.zeros((len(layout.start), 3))
    for k, body in zip(kept, bodies, strict=True):
        node, count = layout.table[k, :2]
        start = layout.positions(layout.out, k)[0]
        rest[node : node + count] = (start - start.mean(axis=0)) / body.size

    def sent(values: np.ndarray, kind: type = np.float32) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values.astype(kind))).to(positions.device)

    return Falls(
        clips=sent(np.array(rows), np.int32),
        positions=positions,
        rest=sent(rest),
        triangles=sent(np.concatenate(layout.boundary), np.int32),
        states=_with_stretches(
            torch.stack([_states(layout, positions, k, b.size) for k, b in zip(kept, bodies, strict=True)])
        ),
        size=sent(size),
        log10_stiffness=sent(log10_dimensionless_stiffness(modulus, density=density, object_size=size)),
        poisson_ratio=sent(np.array([body.poisson_ratio for body in bodies])),
        interval=sent(dimensionless_interval(np.full(len(size), FPS), object_size=size)),
        frames=layout.frames,
    )


def _states(layout: Layout, positions: Tensor, number: int, size: float) -> Float[Tensor, "T S"]:
    """True states of one motion, from the quadrature points of its elements; without stretches."""
    element, elements = (int(v) for v in layout.table[number, 2:4])
    x, device = layout.positions(positions, number), positions.device
    tets = torch.from_numpy(layout.corners[element : element + elements].astype(np.int64)).to(device)
    volumes = torch.from_numpy(layout.geometry[element : element + elements, 9].copy()).to(device)
    now = torch.einsum("qa,teai->teqi", _SHAPES.to(device), x[:, tets]).flatten(1, 2).double()
    share = (volumes.double() / volumes.sum()).repeat_interleave(4) / 4
    return _motion(now, share, size).float()


def _motion(now: Float[Tensor, "T Q 3"], share: Float[Tensor, " Q"], size: float) -> Float[Tensor, "T S"]:
    centre = torch.einsum("q,tqi->ti", share, now)
    arms = now - centre[:, None]
    rest = arms[0]
    spread = torch.einsum("q,qi,qj->ij", share, rest, rest)
    gradient = torch.einsum("q,tqi,qj->tij", share, arms, rest) @ torch.linalg.inv(spread)
    bending = arms - torch.einsum("tij,qj->tqi", gradient, rest)
    heights, order = now[..., 2].sort(dim=1)
    below = share[order].cumsum(dim=1)
    levels = torch.tensor([_OUTERMOST, 1 - _OUTERMOST], device=now.device, dtype=now.dtype).expand(len(now), 2)
    place = torch.searchsorted(below, levels.contiguous()).clamp(max=heights.shape[1] - 1)
    lowest, highest = heights.gather(1, place).unbind(dim=1)
    columns = [
        (centre - centre[:1]) / size,
        torch.stack([lowest, highest - lowest], dim=1) / size,
        torch.zeros(len(now), 4, device=now.device, dtype=now.dtype),
        torch.einsum("q,tqi->t", share, bending**2).sqrt()[:, None] / size,
        (gradient - torch.eye(3, device=now.device, dtype=now.dtype)).flatten(1),
    ]
    return torch.cat(columns, dim=1)


def _with_stretches(states: Float[Tensor, "... S"]) -> Float[Tensor, "... S"]:
    """With the logarithms of the stretches of the gradients that they hold, all at once: small ones take a GPU long."""
    gradient = states[..., 10:].unflatten(-1, (3, 3)).double().cpu() + torch.eye(3, dtype=torch.float64)
    stretches = torch.linalg.svdvals(gradient).clamp(0.1, 10).log()
    both = torch.cat([stretches, stretches.sum(dim=-1, keepdim=True)], dim=-1).to(states)
    return torch.cat([states[..., :5], both, states[..., 9:]], dim=-1)


def turned(states: Float[Tensor, "B T S"], turn: Float[Tensor, "B 3 3"]) -> Float[Tensor, "B T S"]:
    """Of the same motion in other horizontal axes (rows of `turn`)."""
    result = states.clone()
    result[..., :3] = torch.einsum("bij,btj->bti", turn, states[..., :3])
    gradient = states[..., 10:].unflatten(-1, (3, 3))
    result[..., 10:] = torch.einsum("bij,btjk,blk->btil", turn, gradient, turn).flatten(-2)
    return result
