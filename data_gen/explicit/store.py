"""Falling bodies on disk: one file for the falls of a few shapes."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from data_gen.explicit.bodies import FallingBody
from physconvex import ConvergenceError

_NUMBERS = ("size", "youngs_modulus", "poisson_ratio", "density", "damping_time", "friction", "stiffest")


def save_bodies(path: Path, shapes: Sequence[Sequence[FallingBody]], *, drawn: tuple[int, int]) -> None:
    """Write the falls of some shapes, each of which shares corners and tetrahedra, atomically.

    Args:
        path: of the file.
        shapes: the falls of each.
        drawn: numbers of the first shape drawn for it and of the one beyond the last; some draws may fail.

    Raises:
        ConvergenceError: no shape is there.
    """
    if not shapes:
        raise ConvergenceError(f"none of the shapes {drawn[0]} to {drawn[1] - 1} could be meshed")
    bodies = [body for shape in shapes for body in shape]
    first = [shape[0] for shape in shapes]
    content = {name: np.array([getattr(body, name) for body in bodies]) for name in _NUMBERS}
    content |= {name: np.stack([getattr(body, name) for body in bodies]) for name in ("place", "velocity", "spin")}
    for name in ("turns", "centres"):
        content[name] = np.concatenate([getattr(body, name) for body in bodies])
    content["drawn"] = np.array(json.dumps(drawn))
    content["flights"] = np.array([len(body.turns) for body in bodies])
    content["falls"] = np.array([len(shape) for shape in shapes])
    for name in ("corners", "tets"):
        content[name] = np.concatenate([getattr(shape, name) for shape in first])
        content[f"{name}_count"] = np.array([len(getattr(shape, name)) for shape in first])
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **content)
    os.replace(part, path)


def load_bodies(path: Path) -> list[FallingBody]:
    """Read a file of `save_bodies`."""
    with np.load(path, allow_pickle=False) as file:
        content = {name: file[name] for name in file.files}
    corners, tets = (np.split(content[name], np.cumsum(content[f"{name}_count"])[:-1]) for name in ("corners", "tets"))
    turns, centres = (np.split(content[name], np.cumsum(content["flights"])[:-1]) for name in ("turns", "centres"))
    shape = np.repeat(np.arange(len(content["falls"])), content["falls"])
    return [
        FallingBody(
            corners=corners[shape[k]],
            tets=tets[shape[k]],
            place=content["place"][k],
            velocity=content["velocity"][k],
            spin=content["spin"][k],
            turns=turns[k],
            centres=centres[k],
            **{name: float(content[name][k]) for name in _NUMBERS},
        )
        for k in range(len(shape))
    ]
