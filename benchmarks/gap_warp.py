"""Run `physconvex diagnose` on soft bodies that NVIDIA Warp drops, and on bars that it releases.

python benchmarks/gap_warp.py --out warp_bank [--cases none,damping,friction] [--captures-only | --base-only]

Warp (`warp.sim`) has another law (the stable neo-Hookean one of Smith et al. 2018), linear tetrahedra, semi-implicit
Euler in single precision, damping by the rate of F, a contact of springs at the nodes and friction with a small slip.
Its damping also resists rotation, unlike a material: the damped body cannot turn at all, and a bar with that damping is
unstable. The captures contain the surface, not the program's mesh. Needs `pip install "warp-lang<1.10"`, which is no
dependency of this package; later versions do not contain this simulator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from foreign_captures import FLOOR, HELD, RESULTS, markers, run
from scipy.spatial.transform import Rotation

from physconvex.io import Capture, save_capture
from physconvex.mesh import TetMesh, box_mesh, tetrahedralize

GRAVITY, DENSITY, FPS, FRAMES, MARKERS, SIGMA, STEP = 9.81, 1000.0, 50.0, 30, 30, 6e-5, 2e-5
AXES, HEIGHT, TURN = (0.065, 0.05, 0.04), 0.2, (0.4, 0.5, 0.2)  # half axes [m], gap to the floor [m], rotation vector
BAR, CELLS = (0.1, 0.03, 0.03), (20, 6, 6)
YOUNGS_MODULUS, BAR_MODULUS, POISSON_RATIO, NODES = 6e4, 2.5e5, 0.4, 1500
SPRING = 5e3  # stiffness of the contact at a node [N/m]


@dataclass(frozen=True)
class Take:
    """Unstated conditions of a capture, except `velocity` [m/s], which is stated.

    Attributes:
        held: whether it is a bar, held at one end.
        damping: stress per rate of F [Pa s].
        friction: Coulomb's coefficient.
        tilt: tilt of gravity, about y and about x [deg].
        spin: initial angular velocity [rad/s].
        drag: deceleration of the body over the square of its speed [1/m].
        stiffer: Young's modulus of the half at +x of the resting body, over that of the other.
        clock: true over stated frame rate.
        load: mass that hangs at the free end, over that of the bar.
        velocity: initial velocity [m/s].
    """

    held: bool = False
    damping: float = 0.0
    friction: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drag: float = 0.0
    stiffer: float = 1.0
    clock: float = 1.0
    load: float = 0.0
    velocity: tuple[float, float, float] = (0.3, 0.2, 0.0)


BAR_TAKE = Take(held=True, velocity=(0.0, 0.0, 0.0))
CASES = {
    "none": Take(),
    "damping": Take(damping=150.0),
    "friction": Take(friction=0.4, velocity=(0.8, 0.3, 0.0)),
    "gravity_tilt": Take(tilt=(2.5, -1.0)),
    "air_drag": Take(drag=0.4),
    "initial_spin": Take(spin=(0.8, -0.5, 0.3)),
    "heterogeneity": Take(stiffer=3.0),
    "time_scale": Take(clock=1.05),
    "bar_none": BAR_TAKE,
    "bar_gravity_tilt": replace(BAR_TAKE, tilt=(0.0, 6.0)),
    "bar_attached_mass": replace(BAR_TAKE, load=0.4),
    "bar_heterogeneity": replace(BAR_TAKE, stiffer=3.0),
}


def surface_of(take: Take) -> trimesh.Trimesh:
    """Surface of the body at t = 0 [m]."""
    if take.held:
        bar = trimesh.creation.box(BAR)
        bar.apply_translation(np.array(BAR) / 2)
        return bar
    body = trimesh.creation.icosphere(subdivisions=3)
    body.apply_scale(AXES)
    body.apply_transform(_turned())
    body.apply_translation([0.0, 0.0, HEIGHT - body.bounds[0, 2]])
    return body


def _turned() -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(TURN).as_matrix()
    return matrix


def simulated(take: Take, body: trimesh.Trimesh) -> tuple[TetMesh, np.ndarray]:
    """The mesh at t = 0 and its nodes at the frames, shape [T, V, 3]."""
    import warp
    import warp.sim

    mesh = _bar() if take.held else tetrahedralize(body, max_nodes=NODES, method="lattice")
    centre = mesh.vertices.mean(0)
    velocities = np.array(take.velocity) + np.cross(take.spin, mesh.vertices - centre)
    builder = warp.sim.ModelBuilder(up_vector=(0.0, 0.0, 1.0))
    for place, velocity, mass in zip(mesh.vertices, velocities, _masses(take, mesh), strict=True):
        builder.add_particle(tuple(place), tuple(velocity), float(mass), radius=0.0)
    for tet, (mu, lam) in zip(mesh.tets, _constants(take, mesh), strict=True):
        builder.add_tetrahedron(*map(int, tet), mu, lam, take.damping)
    model = builder.finalize(device="cpu")
    model.ground = not take.held
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_kf = SPRING, 0.0, 20.0
    model.soft_contact_mu = take.friction
    x, y = GRAVITY * np.sin(np.radians(take.tilt))
    model.gravity = np.array([x, y, -np.sqrt(GRAVITY**2 - x**2 - y**2)])
    return mesh, _frames(take, model, model.particle_mass.numpy())


def _bar() -> TetMesh:
    """Regular mesh with nodes in the held plane, and diagonals both ways."""
    return box_mesh(BAR, CELLS, order=1, mirrored=True)


def _masses(take: Take, mesh: TetMesh) -> np.ndarray:
    """Masses of the nodes: a quarter of each element's. Warp fixes a node without mass."""
    corners = mesh.vertices[mesh.tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    masses = np.bincount(mesh.tets.ravel(), np.repeat(DENSITY * volumes / 4, 4), len(mesh.vertices))
    if take.held:
        x = mesh.vertices[:, 0]
        end = x > x.max() - 1e-6
        masses[end] += take.load * masses.sum() / end.sum()
        masses[x < x.min() + 1e-6] = 0.0
    return masses


def _constants(take: Take, mesh: TetMesh) -> np.ndarray:
    """Warp's constants of each element [Pa], shape [E, 2]: not Lamé's at rest, see Smith et al., eq. 14."""
    moduli = np.full(len(mesh.tets), BAR_MODULUS if take.held else YOUNGS_MODULUS)
    across = mesh.vertices[:, 0] if take.held else mesh.vertices @ _turned()[:3, 0]
    moduli[across[mesh.tets].mean(1) > np.median(across)] *= take.stiffer
    mu = moduli / (2 * (1 + POISSON_RATIO))
    lam = moduli * POISSON_RATIO / ((1 + POISSON_RATIO) * (1 - 2 * POISSON_RATIO))
    return np.stack([4 / 3 * mu, lam + 5 / 6 * mu], axis=1)


def _frames(take: Take, model: object, masses: np.ndarray) -> np.ndarray:
    """Nodes at the frames [m], shape [T, V, 3]."""
    import warp.sim

    integrator = warp.sim.SemiImplicitIntegrator()
    state, other = model.state(), model.state()  # type: ignore[attr-defined]
    out = [state.particle_q.numpy().astype(float)]
    for _ in range(1, FRAMES):
        for _ in range(round(1 / (take.clock * FPS) / STEP)):
            state.clear_forces()
            if take.drag:
                mean = masses @ state.particle_qd.numpy() / masses.sum()
                state.particle_f.numpy()[:] = -take.drag * np.linalg.norm(mean) * masses[:, None] * mean
            integrator.simulate(model, state, other, STEP)
            state, other = other, state
        out.append(state.particle_q.numpy().astype(float))
    return np.array(out)


def write_capture(folder: Path, name: str) -> None:
    """Marker tracks of thirty surface nodes."""
    take = CASES[name]
    body = surface_of(take)
    mesh, trajectory = simulated(take, body)
    tracks = markers(mesh, trajectory, name, MARKERS, SIGMA, 0.3 * BAR[0] if take.held else 0.0)
    capture = Capture(
        folder, FPS, FRAMES, 2 * FRAMES // 3, density=DENSITY, gravity=np.array([0.0, 0.0, -GRAVITY]),
        initial_velocity=np.array(take.velocity), initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    if take.held:
        save_capture(capture, mesh=body, tracks=tracks, boundary=HELD)
    else:
        save_capture(replace(capture, floor=FLOOR), mesh=body, tracks=tracks)


if __name__ == "__main__":
    run(__doc__, list(CASES), write_capture, RESULTS / "gap_warp.json")
