"""Random scenes of the reduced simulator: how many fail to converge, give NaN, or gain energy.

python benchmarks/reduced_robustness.py --scenes 1000

Each scene draws a family (stiff and nearly incompressible, very soft, thin, of two components, 10 cm, 10 m, or
anything), a law, number of weights, friction, tilt, velocity and spin, and runs for 10 s at 24 frames per second, eight
steps each; steps that raise the energy by more than a thousandth of its scale are cut in two. Results are stored as
they come; a run goes on after the last stored scene. Energy is kinetic + elastic + contact + potential at the frames;
its gain is the largest rise over what it was at any earlier frame, its excess the largest rise over what it was at the
start.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch

from physconvex import ConvergenceError
from physconvex.dynamics import Plane, State, Timing, simulate
from physconvex.fem import ElasticBody
from physconvex.mesh import TetMesh, box_mesh
from physconvex.reduced import (
    BodySamples,
    ReducedBody,
    ReducedEquations,
    ReducedScene,
    ReducedSpace,
    ReducedTrajectory,
    eigenmode_weights,
)

RESULT = Path(__file__).parent / "results" / "reduced_robustness.json"
FRAMES, FPS, STEPS = 241, 24.0, 8
ENERGY_TOLERANCE = 1e-3
FAMILIES = ("stiff", "soft", "thin", "two components", "10 cm", "10 m", "any")


@dataclass(frozen=True)
class Row:
    """One scene.

    Attributes:
        seed: number of the scene; everything follows from it.
        family: what it was drawn from.
        youngs_modulus: E [Pa].
        poisson_ratio: ν.
        size: largest edge [m].
        law: elastic law.
        weights: M.
        friction: of the floor.
        outcome: "finished", "not converged" or "NaN".
        halved_steps: steps that were cut in two.
        projections: matrices that had to be made positive.
        energy_gain: largest rise of the energy over its smallest value before, relative to the kinetic energy at the
            start plus the work of gravity over the body's size.
        energy_excess: largest rise over the energy at the start, relative to the same; negative if it is always less.
        seconds: processor time.
        failure: message of the error.
    """

    seed: int
    family: str
    youngs_modulus: float
    poisson_ratio: float
    size: float
    law: str
    weights: int
    friction: float
    outcome: str
    halved_steps: int
    projections: int
    energy_gain: float
    energy_excess: float
    seconds: float
    failure: str = ""


@cache
def mesh_of(shape: str) -> TetMesh:
    """Quadratic meshes whose largest edge is 1 m."""
    if shape == "plate":
        return box_mesh((1.0, 0.8, 0.06), (4, 3, 1), order=2)
    if shape == "pair":
        one, other = (box_mesh((0.4, 0.4, 0.5), (2, 2, 2), order=2) for _ in range(2))
        vertices = np.concatenate([one.vertices, other.vertices + np.array([0.6, 0.0, 0.0])])
        return TetMesh(vertices, np.concatenate([one.tets, other.tets + len(one.vertices)]))
    return box_mesh((1.0, 0.6, 0.5) if shape == "block" else (1.0, 1.0, 1.0), (2, 2, 2), order=2)


@cache
def space_of(shape: str, size: float, count: int) -> ReducedSpace:
    """Eigenmodes of a scaled mesh."""
    mesh = mesh_of(shape)
    mesh = TetMesh(mesh.vertices * size, mesh.tets)
    return ReducedSpace(eigenmode_weights(ElasticBody(mesh), count), BodySamples.of_mesh(mesh))


def draw(seed: int) -> tuple[Row, ReducedScene]:
    """The scene of a seed, and its row before the run."""
    rng = np.random.default_rng(seed)
    family = FAMILIES[seed % len(FAMILIES)]
    fixed = {"stiff": (1e7, 0.49), "soft": (8e3, 0.4)}
    modulus, ratio = fixed.get(family, (10 ** rng.uniform(4.0, 7.0), rng.uniform(0.0, 0.48)))
    size = {"10 cm": 0.1, "10 m": 10.0}.get(family, 1.0 if family == "any" else 0.3)
    shape = {"thin": "plate", "two components": "pair"}.get(family, str(rng.choice(["block", "cube"])))
    count, law = int(rng.choice([4, 10])), str(rng.choice(["neo_hookean", "neo_hookean_log"]))
    friction = float(rng.choice([0.0, rng.uniform(0.05, 1.0)]))
    space = space_of(shape, size, count)
    density = 10 ** rng.uniform(2.5, 3.5)
    body = ReducedBody(space, law=law, youngs_modulus=modulus, poisson_ratio=ratio, density=density)
    normal = np.array([*rng.normal(scale=0.08, size=2), 1.0])
    lowest = (space.samples.surface_points @ normal).min() / (normal @ normal)
    speed = np.sqrt(9.81 * size)
    scene = ReducedScene(
        body,
        obstacles=(
            Plane(point=(lowest - 0.3 * size * rng.uniform()) * normal, normal=tuple(normal), friction=friction),
        ),
        damping_time=float(rng.choice([0.0, 10 ** rng.uniform(-4, -2)])),
        initial_velocity=0.4 * speed * rng.normal(size=3),
        initial_angular_velocity=0.5 * speed / size * rng.normal(size=3),
    )
    return Row(seed, family, modulus, ratio, size, law, count, friction, "", 0, 0, np.nan, np.nan, np.nan), scene


def energy_rises(scene: ReducedScene, run: ReducedTrajectory) -> tuple[float, float]:
    """Largest rise of the energy over its running minimum and over its start, see `Row`."""
    states = map(State, run.times, run.coordinates, run.velocities)
    equations = ReducedEquations(scene)
    energy = np.array([equations.energy(state) for state in states]) / scene.energy_scale
    return float((energy - np.minimum.accumulate(energy)).max()), float((energy[1:] - energy[0]).max())


def measure(seed: int) -> Row:
    """Run one scene."""
    row, scene = draw(seed)
    clock, found = time.process_time(), asdict(row)
    try:
        run = simulate(scene, Timing(frames=FRAMES, fps=FPS, steps_per_frame=STEPS, energy_tolerance=ENERGY_TOLERANCE))
        finite = bool(np.isfinite(run.coordinates).all() and np.isfinite(run.velocities).all())
        found["outcome"] = "finished" if finite else "NaN"
        found["halved_steps"], found["projections"] = run.statistics.halved_steps, run.statistics.projections
        found["energy_gain"], found["energy_excess"] = energy_rises(scene, run)
    except ConvergenceError as error:
        found["outcome"], found["failure"] = "not converged", str(error)
    found["seconds"] = time.process_time() - clock
    return Row(**found)


def main() -> None:
    """Go on until the number of scenes or the time is reached."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", type=int, default=1000, help="number of scenes in all")
    parser.add_argument("--minutes", type=float, default=np.inf, help="no further scene is begun after that")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = [Row(**row) for row in json.loads(RESULT.read_text())["rows"]] if RESULT.is_file() else []
    end = time.monotonic() + 60 * options.minutes
    for seed in range(len(rows), options.scenes):
        if time.monotonic() > end:
            break
        rows.append(measure(seed))
        print(rows[-1], flush=True)
        content = {"command": "python benchmarks/reduced_robustness.py", "rows": [asdict(row) for row in rows]}
        RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(Counter((row.family, row.outcome) for row in rows))


if __name__ == "__main__":
    main()
