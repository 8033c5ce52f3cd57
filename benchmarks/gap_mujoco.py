"""Run `physconvex diagnose` on MuJoCo captures of dropped soft cubes and released beams, some with hidden effects.

python benchmarks/gap_mujoco.py --out mujoco_bank [--cases none,damping,friction] [--captures-only | --base-only]

MuJoCo has another law (Saint Venant–Kirchhoff), linear tetrahedra that lock, semi-implicit Euler, and a soft contact
that dissipates energy itself (the cube sinks in by 6 % of its size). The captures contain its mesh. Needs `pip install
mujoco==4.0.0 mujoco-core==4.0.0` (both of one version), which is no dependency of this package.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from foreign_captures import FLOOR, HELD, RESULTS, markers, run

from physconvex.io import Capture, save_capture
from physconvex.mesh import TetMesh

SIZE, COUNT, GAP, DENSITY, STEP, FPS, FRAMES, MARKERS, SIGMA = 0.12, 7, 0.2, 1000.0, 1e-4, 50.0, 30, 30, 6e-5
GRAVITY = 9.81
BEAM, GRID, BEAM_DENSITY, BEAM_STEP, BEAM_FPS, BEAM_FRAMES = (0.1, 0.03, 0.03), (11, 4, 4), 1070.0, 2e-5, 100.0, 45


@dataclass(frozen=True)
class Drop:
    """Unstated: MuJoCo damping [s], friction, gravity tilt [deg], spin [rad/s], drag [1/m]. Stated: velocity [m/s]."""

    damping: float = 5e-5
    friction: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drag: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)


CASES = {
    "none": Drop(),
    "damping": Drop(damping=3e-3),
    "friction": Drop(friction=0.4, velocity=(0.8, 0.3, 0.0)),
    "gravity_tilt": Drop(tilt=(2.5, -1.0)),
    "air_drag": Drop(drag=0.4),
    "initial_spin": Drop(spin=(0.8, -0.5, 0.3)),
}


@dataclass(frozen=True)
class Release:
    """A beam held at one end: MuJoCo's damping [s], tilt of gravity [deg], load at the free end over its own mass."""

    damping: float = 5e-5
    tilt: tuple[float, float] = (0.0, 0.0)
    load: float = 0.0


BEAMS = {
    "beam_none": Release(),
    "beam_damping": Release(damping=5e-4),
    "beam_gravity_tilt": Release(tilt=(0.0, 6.0)),
    "beam_attached_mass": Release(load=0.6),
}


def scene_of(drop: Drop) -> str:
    """MuJoCo's description of the scene."""
    x, y = GRAVITY * np.sin(np.radians(drop.tilt))
    spacing = SIZE / (COUNT - 1)
    contact = f'friction="{max(drop.friction, 1e-5)} 1e-5 1e-5" condim="{3 if drop.friction else 1}"'
    return f"""<mujoco><option timestep="{STEP}" gravity="{x} {y} {-np.sqrt(GRAVITY**2 - x**2 - y**2)}" solver="CG"
        tolerance="1e-8" iterations="50" integrator="Euler" cone="elliptic"/><size memory="500M"/><worldbody>
        <geom type="plane" size="5 5 .1" {contact} priority="1" solref=".01 1"/>
        <flexcomp name="b" type="grid" dim="3" count="{COUNT} {COUNT} {COUNT}" spacing="{spacing} {spacing} {spacing}"
        pos="0 0 {GAP + SIZE / 2}" mass="{DENSITY * SIZE**3}" radius="0.0005"><contact selfcollide="none"/>
        <elasticity young="5e4" poisson="0.4" damping="{drop.damping}"/></flexcomp></worldbody></mujoco>"""


def simulated(drop: Drop) -> tuple[TetMesh, np.ndarray]:
    """The mesh at t = 0 and its nodes at the frames, shape [T, V, 3]."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene_of(drop))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rest, bodies = data.flexvert_xpos.copy(), model.flex_vertbodyid
    at = model.body_dofadr[bodies][:, None] + np.arange(3)
    masses = model.body_mass[bodies]
    data.qvel[at] = np.array(drop.velocity) + np.cross(drop.spin, rest - rest.mean(0))
    out = [rest]
    for _ in range(1, FRAMES):
        for _ in range(round(1 / FPS / STEP)):
            mean = masses @ data.qvel[at] / masses.sum()
            data.xfrc_applied[bodies, :3] = -drop.drag * np.linalg.norm(mean) * masses[:, None] * mean
            mujoco.mj_step(model, data)
        out.append(data.flexvert_xpos.copy())
    return _mesh(model, rest), np.array(out)


def _mesh(model: object, rest: np.ndarray) -> TetMesh:
    tets = model.flex_elem[: 4 * model.flex_elemnum[0]].reshape(-1, 4).astype(int)  # type: ignore[attr-defined]
    inverted = np.linalg.det(rest[tets[:, 1:]] - rest[tets[:, :1]]) < 0
    tets[inverted] = tets[inverted][:, [0, 2, 1, 3]]
    return TetMesh(rest, tets)


def released(release: Release) -> tuple[TetMesh, np.ndarray]:
    """The beam's mesh at t = 0 and its nodes at the frames, shape [T, V, 3]."""
    import mujoco

    x, y = GRAVITY * np.sin(np.radians(release.tilt))
    spacing = " ".join(str(length / (n - 1)) for length, n in zip(BEAM, GRID, strict=True))
    mass = BEAM_DENSITY * float(np.prod(BEAM))
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{BEAM_STEP}" gravity="{x} {y} {-np.sqrt(GRAVITY**2 - x**2 - y**2)}" solver="CG"
        tolerance="1e-8" iterations="50" integrator="Euler"/><size memory="500M"/><worldbody>
        <flexcomp name="b" type="grid" dim="3" count="{GRID[0]} {GRID[1]} {GRID[2]}" spacing="{spacing}"
        pos="{BEAM[0] / 2} 0 0" mass="{mass}" radius="0.0005"><contact selfcollide="none" contype="0" conaffinity="0"/>
        <elasticity young="2.5e5" poisson="0.45" damping="{release.damping}"/>
        <pin gridrange="0 0 0 0 {GRID[1] - 1} {GRID[2] - 1}"/></flexcomp></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rest = data.flexvert_xpos.copy()
    end = np.unique(model.flex_vertbodyid[rest[:, 0] > rest[:, 0].max() - 1e-6])
    weight = release.load * mass / len(end)
    model.body_mass[end] += weight
    model.body_inertia[end] += 1e-9
    mujoco.mj_setConst(model, data)
    out = [rest]
    for _ in range(1, BEAM_FRAMES):
        for _ in range(round(1 / BEAM_FPS / BEAM_STEP)):
            mujoco.mj_step(model, data)
        out.append(data.flexvert_xpos.copy())
    return _mesh(model, rest), np.array(out)


def write_beam(folder: Path, name: str) -> None:
    """Marker tracks of sixteen surface nodes; the held end is a box."""
    mesh, trajectory = released(BEAMS[name])
    capture = Capture(
        folder, BEAM_FPS, BEAM_FRAMES, 2 * BEAM_FRAMES // 3, density=BEAM_DENSITY,
        gravity=np.array([0.0, 0.0, -GRAVITY]),
    )  # fmt: skip
    save_capture(capture, tets=mesh, tracks=markers(mesh, trajectory, name, 16, SIGMA, 0.3 * BEAM[0]), boundary=HELD)


def write_capture(folder: Path, name: str) -> None:
    """Marker tracks of thirty surface nodes."""
    if name in BEAMS:
        write_beam(folder, name)
        return
    mesh, trajectory = simulated(CASES[name])
    capture = Capture(
        folder, FPS, FRAMES, 2 * FRAMES // 3, density=DENSITY, gravity=np.array([0.0, 0.0, -GRAVITY]), floor=FLOOR,
        initial_velocity=np.array(CASES[name].velocity), initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    save_capture(capture, tets=mesh, tracks=markers(mesh, trajectory, name, MARKERS, SIGMA))


if __name__ == "__main__":
    run(__doc__, [*CASES, *BEAMS], write_capture, RESULTS / "gap_mujoco.json")
