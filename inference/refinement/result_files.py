"""The files of a refinement: JSON, arrays, plots, comparison video."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from inference.refinement.options import RefineOptions
from inference.refinement.pictures import draw_fit, write_side_by_side
from inference.refinement.result import Refinement
from physconvex import __version__
from physconvex.convex import write_ply
from physconvex.io import load_capture, write_json


def write_refinement(
    found: Refinement,
    out: str | os.PathLike[str],
    *,
    options: RefineOptions | None = None,
    command: Sequence[str] | None = None,
    pictures: bool = True,
) -> None:
    """Write `refinement.json`, `trajectory.npz`, `field.ply`, `fit.png`, `side_by_side.mp4` and `run.json`.

    Args:
        found: the refinement.
        out: the folder; it is made.
        options: the settings, for `run.json`.
        command: the command line, for `run.json`; this process's unless given.
        pictures: plots and video also.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    motion = found.motion
    np.savez_compressed(
        folder / "trajectory.npz",
        times=motion.times,
        vertices=motion.vertices.astype(np.float32),
        faces=motion.faces,
        markers=motion.markers,
        handles=motion.handles,
        weight_points=motion.weight_points,
        weights=motion.weights.astype(np.float32),
        followed_vertices=(found.followed or motion).vertices.astype(np.float32),
    )
    if found.appearance is not None:
        write_ply(found.appearance.field, folder / "field.ply")
    if pictures:
        capture = load_capture(found.path)
        draw_fit(found, capture, folder / "fit.png")
        write_side_by_side(found, capture, folder / "side_by_side.mp4")
    run: dict[str, JsonValue] = {
        "command": shlex.join(sys.argv if command is None else command),
        "physconvex": __version__,
        "python": platform.python_version(),
        "options": RefineOptions.or_default(options).to_json(),
    }
    write_json(folder / "run.json", run)
    write_json(folder / "refinement.json", found.to_json())
