"""Run `physconvex diagnose` on the front-camera video of filmed drops, with and without hidden effects.

python benchmarks/gap_video.py --objects FOLDER --out gap_video [--cases damping,none,focal_length,exposure,motion_blur]

FOLDER contains Google Scanned Objects, one folder each with `model.obj` and `texture.png`. The full-order model drops
the toy, on another mesh than the diagnosis makes. The front camera and the side camera (a held-out view) film it at 24
frames per second and 224 pixels. `capture.json` states the floor and the start at rest, but no damping. In
`focal_length` only the camera is wrong: its stated focal length is 3 % too long, and the answer must not be a material.
The same holds for the last two: the light fades by half a stop, or the shutter stays open for half of the frame time
(rendered 17 times in it). Stored results of other cases are kept.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from foreign_captures import RESULTS, answer, store
from scipy.interpolate import CubicSpline

from data_gen import (
    FLAT,
    BenchmarkOptions,
    ObjectMesh,
    StillViews,
    drop_object,
    load_user_mesh,
    placed,
    rendered_frames,
    still_cameras,
)
from physconvex.io import CAPTURE_FILE, Camera, write_video

TOY = "SCHOOL_BUS"
RESULT = RESULTS / "gap_video.json"


@dataclass(frozen=True)
class Film:
    """Damping time [s], stated over true focal length, drift of the light [1/s], time the shutter is open [s]."""

    damping_time: float = 0.0
    focal_length: float = 1.0
    drift: float = 0.0
    exposure_time: float = 0.0


CASES = {
    "damping": Film(damping_time=12e-3),
    "none": Film(),
    "focal_length": Film(focal_length=1.03),
    "exposure": Film(drift=-0.35),
    "motion_blur": Film(exposure_time=0.5 / 24),
}


def main() -> None:
    """Film, diagnose with the default settings, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", default=",".join(CASES))
    given = parser.parse_args()
    for name in given.cases.split(","):
        film, folder = CASES[name], given.out / name
        capture = filmed(folder / "capture", given.objects, film)
        content = {"truth": asdict(film)} | answer(capture, folder / "diagnosis")
        store(RESULT, name, content)
        print(json.dumps(content, indent=1))


def filmed(folder: Path, objects: Path, film: Film) -> Path:
    """Simulate and film the drop; return the capture."""
    if folder.exists():
        return folder
    mesh = objects / TOY / "model.obj"
    options = BenchmarkOptions(size=224, views=2, nodes=600, fill=False, steps_per_frame=24)
    truth = {"youngs_modulus": 1e5, "poisson_ratio": 0.4, "damping_time": film.damping_time}
    sharp = folder.parent.parent / f"sharp_{1e3 * film.damping_time:g}ms"
    sharp, moved = drop_object(sharp, mesh, truth, options, np.random.default_rng(2))
    body = placed(load_user_mesh(mesh), options.object_size, np.random.default_rng(2))
    partial = folder.with_name("partial")
    shutil.copytree(sharp, partial, dirs_exist_ok=True)
    cameras = still_cameras(moved.reshape(-1, 3), StillViews(4, (12.0, 28.0), name="view"), options.size)[:2]
    for camera in cameras:
        frames = filmed_by(camera, body, moved, film.exposure_time * options.fps)
        fading = np.exp(film.drift * np.arange(len(frames)) / options.fps / 2.2)[:, None, None, None]
        write_video(partial / f"{camera.name}.mp4", (frames * fading).round().astype(np.uint8), fps=options.fps, crf=6)
    content = json.loads((partial / CAPTURE_FILE).read_text(encoding="utf-8"))
    content["cameras"] = [camera.to_json() for camera in cameras]
    front = content["cameras"][0]
    front["fl_x"], front["fl_y"] = film.focal_length * front["fl_x"], film.focal_length * front["fl_y"]
    (partial / CAPTURE_FILE).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return partial.rename(folder)


def filmed_by(camera: Camera, body: ObjectMesh, moved: np.ndarray, share: float) -> np.ndarray:
    """The linear-light pictures on white, each averaged over that share of a frame around its time."""
    motion, parts = CubicSpline(np.arange(len(moved)), moved), np.linspace(-0.5, 0.5, 17 if share else 1) * share
    frames = []
    for t in range(len(moved)):
        times = (t + parts).clip(0, len(moved) - 1)
        rgba = np.stack(rendered_frames(body.drawn(), camera, FLAT, motion(times))) / 255.0
        light = (rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]) ** 2.2
        frames.append((255 * light.mean(0) ** (1 / 2.2)).round())
    return np.stack(frames)


if __name__ == "__main__":
    main()
