"""A recording of the silicone beam as a capture folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from docs.figures.fem_cases.measured import GRAVITY, recording
from physconvex.io import Boundary, Capture, Tracks, save_capture
from physconvex.mesh import TetMesh, box_mesh

__all__ = ["beam_capture"]

SIGMA = 1e-4  # m: what markers that shake on 6 mm feet are off by; the camera system's own noise is 5 to 15 µm


def beam_capture(
    folder: Path, name: str, *, frames: int, observed: int, offset_ms: float, cells: tuple[int, int, int]
) -> Capture:
    """Three markers of the tip from the release on, 100 frames per second, clamped at the base; loads are not told.

    Args:
        folder: to be written.
        name: of the recording, "gravity" or "load101".
        frames, observed: number of frames, and of those that may be fitted.
        offset_ms: of the release after the first frame that moves; it lies somewhere within a frame.
        cells: of the box along each edge.
    """
    run = recording(name)
    rest = run.held(run.tips)
    times = run.times[run.release_frame] + 1e-3 * offset_ms + np.arange(frames) / 100
    positions = CubicSpline(run.times, run.tips)(times)
    positions[0] = rest
    capture = Capture(
        folder, 100.0, frames, observed, gravity=np.array(GRAVITY), density=1070.0, initial_velocity=np.zeros(3),
        initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    box = box_mesh((0.1, 0.03, 0.03), cells, order=1)
    tets = TetMesh(box.vertices - np.array([0.1, 0, 0]), box.tets)
    clamp = Boundary(clamped_box=np.array([[-0.1001, -1, -1], [-0.0999, 1, 1]]))
    tracks = Tracks(rest, positions, np.full(positions.shape[:2], SIGMA))
    save_capture(capture, tets=tets, tracks=tracks, boundary=clamp)
    return capture
