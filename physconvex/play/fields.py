"""A convex field that moves with its body: vertices, half-spaces, pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8

from physconvex.convex import ConvexField, bind_to_space, half_spaces, move_half_spaces, space_map, write_ply
from physconvex.io import look_at
from physconvex.play.roll_out import PlayedObject
from physconvex.reduced import ReducedTrajectory
from physconvex.render import film

_FIELD_OF_VIEW, _SIZE = 0.52, 448  # [rad], [px]


def moving_fields(field: ConvexField, run: ReducedTrajectory) -> Iterator[ConvexField]:
    """The field at each frame: its vertices move with the body, its colours rotate with it."""
    bound = bind_to_space(field, run.space)
    return (bound.at(coordinates) for coordinates in run.coordinates)


def moving_half_spaces(
    field: ConvexField, run: ReducedTrajectory
) -> tuple[Float[np.ndarray, "T N H 3"], Float[np.ndarray, "T N H"]]:
    """Normals and offsets [m] of the half-spaces n · x ≤ d of every convex at each frame.

    Each plane moves with the deformation at its own foot (`physconvex.convex.move_half_spaces`).
    """
    spaces, centres = half_spaces(field), field.centres
    moved = [move_half_spaces(spaces, centres, space_map(run.space, y)) for y in run.coordinates]
    normals, offsets = ([getattr(m, name).detach().cpu().numpy() for m in moved] for name in ("normals", "offsets"))
    return np.stack(normals), np.stack(offsets)


def write_fields(played: PlayedObject, folder: Path) -> None:
    """Write convexes/000000.ply … and half_spaces.npz of each object that is a convex field."""
    for number, (field, run) in enumerate(zip(played.convexes, played.trajectories, strict=True)):
        if field is None:
            continue
        label = "" if len(played.trajectories) == 1 else f"_{number}"
        target = folder / f"convexes{label}"
        target.mkdir(exist_ok=True)
        for frame, moved in enumerate(moving_fields(field, run)):
            write_ply(moved, target / f"{frame:06d}.ply")
        normals, offsets = moving_half_spaces(field, run)
        np.savez_compressed(folder / f"half_spaces{label}.npz", normals=normals, offsets=offsets)


def frames_of_field(played: PlayedObject) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """Pictures of an object that is a convex field, by the convex renderer; the camera of `frames_of`, no floor."""
    field = played.convexes[0]
    assert field is not None
    eye, middle, _ = played.viewpoint()
    camera = look_at(eye, middle, width=_SIZE, height=_SIZE, vertical_field_of_view=_FIELD_OF_VIEW)
    moved = (one.to(torch.float32) for one in moving_fields(field, played.trajectory))
    return film(moved, [camera] * len(played.positions))
