"""Write a played object: trajectory, one PLY per frame, and its configuration."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from pydantic import JsonValue

import physconvex
from physconvex.io import write_video
from physconvex.play.animated_glb import write_animated_glb
from physconvex.play.fields import frames_of_field, write_fields
from physconvex.play.pictures import frames_of
from physconvex.play.roll_out import PlayedObject


def summary_of(played: PlayedObject) -> dict[str, JsonValue]:
    """Numbers worth a look, with their units in the names."""
    heights = played.positions[:, :, 2]
    start, end = (float(np.ptp(heights[k])) for k in (0, -1))
    return {
        "frames": len(played.positions),
        "objects": len(played.trajectories),
        "vertices": len(played.surface.vertices),
        "mass_kg": played.mass,
        "volume_m3": played.volume,
        "height_first_m": start,
        "height_last_m": end,
        "centre_last_m": played.positions[-1].mean(0).tolist(),
        "lowest_m": float(heights.min()),
        "convexes": [{**one.to_json()} for one in played.adapted if one is not None],
        "statistics": asdict(played.trajectory.statistics),
    }


def write_played(
    played: PlayedObject, folder: str | Path, *, ply: bool = True, glb: bool = True, video: bool = False
) -> None:
    """Write into a folder, which is created if necessary.

    - trajectory.npz: times [T] s, rest [V, 3] m, faces [F, 3], positions [T, V, 3] m, owners [V] (the object of each
      vertex), and the handles Z_m(t) [T, M + 1, 3, 4] of the reduced body, `handles_0`, `handles_1` … of several;
    - convexes/000000.ply … and half_spaces.npz: a convex field at each frame, vertices and half-spaces;
    - frames/000000.ply …: the surface at each frame (unless `ply` is false);
    - animation.glb: the surface in motion, for any glTF viewer (unless `glb` is false);
    - video.mp4: pictures of it over its floor (if `video` is true; needs OpenGL, no display);
    - simulation.json: version, resolved configuration, summary.
    """
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    several = len(played.trajectories) > 1
    handles: dict[str, Any] = {
        f"handles_{k}" if several else "handles": run.handles() for k, run in enumerate(played.trajectories)
    }
    np.savez_compressed(
        out / "trajectory.npz",
        times=played.trajectory.times,
        rest=played.surface.vertices,
        faces=played.surface.faces,
        positions=played.positions,
        owners=played.owners,
        **handles,
    )
    write_fields(played, out)
    if ply:
        (out / "frames").mkdir(exist_ok=True)
        for number, vertices in enumerate(played.positions):
            mesh = trimesh.Trimesh(vertices, played.surface.faces, process=False)
            mesh.export(out / "frames" / f"{number:06d}.ply")
    if glb:
        times = played.trajectory.times
        write_animated_glb(out / "animation.glb", times, played.positions, played.surface.faces)
    if video:
        alone = len(played.convexes) == 1 and played.convexes[0] is not None
        pictures = frames_of_field(played) if alone else frames_of(played)
        write_video(out / "video.mp4", pictures, fps=played.config.time.fps)
    record = {
        "version": physconvex.__version__,
        "configuration": played.config.model_dump(mode="json"),
        "summary": summary_of(played),
    }
    (out / "simulation.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
