"""Run `physconvex diagnose` on real recordings whose gap has a known kind but an unknown dose.

python benchmarks/gap_recordings.py --out recordings [--cases struck_ball,striking_ball,soft_fish] [--captures-only]

`struck_ball` and `striking_ball`: two tennis balls on a floor, tracked in a film from their collision on. The capture
states no friction; the struck ball slides and then rolls, the other arrives rolling. Only the centre of each is known,
so the model is a solid ball of the same mass. A real ball is hollow: after sliding it rolls with 3/5 of its speed, a
solid one with 5/7. `soft_fish`: an upright silicone tail, held below, which compressed air bends to one side. The
capture does not state this, and the dictionary has no such effect. Its tip is the one marker on the body. The data are
in `tests/data`, with their sources.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from foreign_captures import FLOOR, HELD, RESULTS, run

from physconvex.io import Boundary, Capture, Tracks, save_capture
from physconvex.numerics import best_rotation

DATA = Path(__file__).parents[1] / "tests" / "data"
RADIUS, MASS, BALL_SIGMA = 0.03429, 0.0577, 4e-4  # [m], [kg], [m] of second differences, 0.1 to 0.6 mm
FIRST = 12  # first frame in which the balls no longer touch
DENSITY, FISH_SIGMA, FISH_FRAMES = 1070.0, 1e-4, 60
# places of the markers on the tail and on its holder [m], from the authors' script of the same recording
FISH_POINTS = [[0, -0.01419, 0.05221], [0, -0.032, -0.007], [-0.01612, -0.032, -0.026622], [0.01612, -0.032, -0.026622]]


def write_ball(folder: Path, name: str) -> None:
    """The middle of a ball, 60 frames per second."""
    rows = np.genfromtxt(DATA / "diffpd_tennis_balls" / "ball_positions.csv", delimiter=",", names=True)
    ball = "b1" if name == "struck_ball" else "b2"
    positions = np.stack([rows[f"{ball}_{axis}_m"] for axis in "xyz"], axis=1)[FIRST:, None]
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
    mesh.apply_translation(positions[0, 0])
    spin = np.zeros(3) if name == "struck_ball" else None  # it lies still
    capture = Capture(
        folder, 60.0, len(positions), 2 * len(positions) // 3, density=MASS / (4 / 3 * np.pi * RADIUS**3),
        floor=FLOOR, initial_angular_velocity=spin,
    )  # fmt: skip
    save_capture(capture, mesh=mesh, tracks=Tracks(positions[0], positions, np.full(positions.shape[:2], BALL_SIGMA)))


def write_fish(folder: Path) -> None:
    """The tip of the tail, 100 frames per second, in a frame with the tail upright on z = 0."""
    markers = np.genfromtxt(DATA / "srl_soft_fish" / "soft_fish_data.csv", delimiter=";").reshape(-1, 4, 3) / 1e3
    points = np.array(FISH_POINTS)
    turn = best_rotation(markers[0], points)
    tip = (markers[:FISH_FRAMES, 0] - markers[0].mean(0)) @ turn.T + points.mean(0)
    mesh = trimesh.load(DATA / "srl_soft_fish" / "soft_fish.stl")
    mesh.apply_scale(1e-3)
    mesh.apply_translation([*-mesh.bounds.mean(0)[:2], 0.0])
    capture = Capture(
        folder, 100.0, FISH_FRAMES, 2 * FISH_FRAMES // 3, density=DENSITY, initial_velocity=np.zeros(3),
        initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    held = Boundary(clamped_box=HELD.clamped_box[:, [1, 2, 0]])  # type: ignore[index]
    tracks = Tracks(tip[:1], tip[:, None], np.full((FISH_FRAMES, 1), FISH_SIGMA))
    save_capture(capture, mesh=mesh, tracks=tracks, boundary=held)


def write_capture(folder: Path, name: str) -> None:
    """A recording as a capture folder."""
    if name == "soft_fish":
        write_fish(folder)
    else:
        write_ball(folder, name)


if __name__ == "__main__":
    run(__doc__, ["struck_ball", "striking_ball", "soft_fish"], write_capture, RESULTS / "gap_recordings.json")
