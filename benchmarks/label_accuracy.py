"""How far E and ν act to be off in the discretisation that makes training clips.

For a sample of random objects over the stiffness range, the generator's run is compared with a reference on the same
geometry (every tetrahedron split into eight, twice as many time steps, Newton's tolerance 1e-6). The offset
(Δ log10 E, Δν) is what must be added to the labels of the generator's run to fit the reference best, by Gauss–Newton
on the trajectories of all nodes with central differences; the residual rms before and after is stored too. Cases that
the result file holds for the same arguments and discretisation are not run again.

    python benchmarks/label_accuracy.py --objects 12 --seed 0

`--falls` measures the explicit roll-outs that training on falls draws (`data_gen/explicit`: 1,900 nodes at most, masses
in the nodes, no further nodes where the body lands) against a reference of the implicit simulator in the same way.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from data_gen import (
    Drop,
    ObjectMesh,
    SolverConfig,
    falling_body,
    lay_out,
    load_config,
    random_object,
    refine_at_landing,
    roll_out,
)
from physconvex import ConvergenceError, InputError
from physconvex.dynamics import Plane, World, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import TetMesh, linear_part, refine_uniformly, tetrahedralize_implicit

FALL_NODES = 1900
STEP_E, STEP_NU = 0.05, 0.02  # central differences in log10 E and ν
RESULT = Path(__file__).parent / "results" / "label_accuracy.json"


@dataclass(frozen=True)
class Case:
    """One object with its motion and material (SI units)."""

    mesh: TetMesh
    youngs_modulus: float
    poisson_ratio: float
    damping_time: float
    friction: float
    angular_velocity: np.ndarray


@dataclass(frozen=True)
class Offset:
    """Result for one case; lengths in metres, times in seconds."""

    index: int
    family: str
    nodes: int
    reference_nodes: int
    size: float
    youngs_modulus: float
    poisson_ratio: float
    offset_log10_youngs_modulus: float
    offset_poisson_ratio: float
    standard_error_poisson_ratio: float
    rms_before: float
    rms_after: float
    motion_rms: float
    seconds: float
    reference_seconds: float


def draw(seed: int, index: int, count: int, solver: SolverConfig) -> tuple[Case, str]:
    """Case `index` of `count`; E is stratified over 1e4–1e7 Pa. A body that cannot be meshed is drawn anew."""
    rng = np.random.default_rng((seed, index))
    while True:
        thing = random_object(rng)
        size = float(np.exp(rng.uniform(np.log(0.5), np.log(1.5))))
        surface = (thing.vertices, thing.faces)
        try:
            mesh = tetrahedralize_implicit(
                thing.signed_distance, thing.bounds, surface=surface, max_nodes=solver.target_nodes, order=2
            )
            break
        except (ConvergenceError, InputError) as error:
            print(f"{thing.name} is drawn anew: {error}", file=sys.stderr)
    x = Rotation.random(random_state=int(rng.integers(2**31))).apply(mesh.vertices) * (size / mesh.size)
    x[:, 2] += rng.uniform(0.3, 1.5) * size - x[:, 2].min()
    youngs_modulus = 10 ** (4 + 3 * (index + rng.uniform()) / count)
    case = Case(
        TetMesh(x, mesh.tets),
        youngs_modulus,
        rng.uniform(0.2, 0.49),
        float(np.exp(rng.uniform(np.log(5e-4), np.log(2e-3)))),
        rng.uniform(0.2, 1.0),
        rng.normal(size=3),
    )
    gravity = load_config("training").motion.gravity
    flight = World(gravity=gravity, initial_angular_velocity=case.angular_velocity)
    mesh = refine_at_landing(case.mesh, solver.landing_nodes, flight)
    return replace(case, mesh=mesh), thing.family


def run(
    case: Case, mesh: TetMesh, solver: SolverConfig, *, log10_shift: float = 0.0, nu_shift: float = 0.0
) -> np.ndarray:
    """Positions [T, V, 3] m with shifted material, contact law fixed by the unshifted one."""
    body = ElasticBody(
        mesh,
        youngs_modulus=case.youngs_modulus * 10**log10_shift,
        poisson_ratio=case.poisson_ratio + nu_shift,
    )
    scene = Scene(
        body,
        obstacles=(Plane(friction=case.friction),),
        damping_time=case.damping_time,
        initial_angular_velocity=case.angular_velocity,
        contact_stiffness=50 * case.youngs_modulus / mesh.size,
        contact_smoothing=5e-4 * mesh.size,
    )
    return simulate(scene, solver.timing()).positions


def roll(case: Case, *, log10_shift: float = 0.0, nu_shift: float = 0.0) -> np.ndarray:
    """Positions [T, V, 3] m of the explicit roll-out, with shifted material."""
    linear = linear_part(case.mesh)
    drop = Drop(
        object_id="",
        family="",
        body=ObjectMesh(*linear.surface, "", ""),
        rotation=np.eye(3),
        shift=np.zeros(3),
        size=case.mesh.size,
        youngs_modulus=case.youngs_modulus * 10**log10_shift,
        poisson_ratio=case.poisson_ratio + nu_shift,
        density=1000.0,
        damping_time=case.damping_time,
        friction=case.friction,
        initial_velocity=(0.0, 0.0, 0.0),
        initial_angular_velocity=tuple(case.angular_velocity),
    )
    body = falling_body(drop, case.mesh)
    layout = lay_out([body])
    moved = layout.positions(roll_out(layout, "cpu"), 0).numpy().astype(np.float64)
    return moved[:, cKDTree(body.mesh().vertices).query(case.mesh.vertices)[1]]


def finer(solver: SolverConfig) -> SolverConfig:
    """In time: half the steps' length, Newton's tolerance 1e-6."""
    steps = {name: 2 * getattr(solver, name) for name in ("steps_per_frame", "flight_steps_per_frame")}
    return solver.model_copy(update=steps | {"tolerance": min(solver.tolerance, 1e-6)})


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt((difference**2).sum(-1).mean()))


def measure(index: int, case: Case, family: str, solver: SolverConfig, *, falls: bool = False) -> Offset:
    """Offset of one case."""
    made = partial(roll, case) if falls else partial(run, case, case.mesh, solver)
    clock = time.perf_counter()
    coarse = made()
    seconds = time.perf_counter() - clock
    fine = refine_uniformly(case.mesh)
    clock = time.perf_counter()
    nodes = cKDTree(fine.vertices).query(case.mesh.vertices)[1]
    reference = run(case, fine, finer(solver))[:, nodes]
    reference_seconds = time.perf_counter() - clock
    low, high = max(-STEP_NU, -case.poisson_ratio), min(STEP_NU, 0.495 - case.poisson_ratio)

    def shifted(e: float, nu: float) -> np.ndarray:
        return made(log10_shift=e, nu_shift=nu)

    by_e = (shifted(STEP_E, 0.0) - shifted(-STEP_E, 0.0)) / (2 * STEP_E)
    by_nu = (shifted(0.0, high) - shifted(0.0, low)) / (high - low)
    jacobian = np.stack([by_e.ravel(), by_nu.ravel()], axis=1)
    residual = (reference - coarse).ravel()
    offset = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    left = residual - jacobian @ offset
    # residuals of one body move together: count one independent residual per frame, not per node
    covariance = np.linalg.inv(jacobian.T @ jacobian) * (left @ left) / len(left) * (len(left) / len(coarse))
    return Offset(
        index=index,
        family=family,
        nodes=len(case.mesh.vertices),
        reference_nodes=len(fine.vertices),
        size=case.mesh.size,
        youngs_modulus=case.youngs_modulus,
        poisson_ratio=case.poisson_ratio,
        offset_log10_youngs_modulus=float(offset[0]),
        offset_poisson_ratio=float(offset[1]),
        standard_error_poisson_ratio=float(np.sqrt(covariance[1, 1])),
        rms_before=_rms(reference - coarse),
        rms_after=_rms(left.reshape(coarse.shape)),
        motion_rms=_rms(reference - reference[:1]),
        seconds=seconds,
        reference_seconds=reference_seconds,
    )


def main() -> None:
    """Measure and store; one line per case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="+", default=None, help="indices of the cases to run, from 0")
    parser.add_argument("--falls", action="store_true", help="of the explicit roll-outs")
    parser.add_argument("--nodes", type=int, default=None, help="most nodes of a clip's mesh; the generator's default")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    options.out = options.out or (RESULT.with_name("label_accuracy_falls.json") if options.falls else RESULT)
    torch.set_num_threads(1)
    solver = load_config("training").solver
    if options.falls:
        solver = solver.model_copy(update={"target_nodes": FALL_NODES, "landing_nodes": 0})
    if options.nodes is not None:
        solver = solver.model_copy(update={"target_nodes": options.nodes})
    settings = {"objects": options.objects, "seed": options.seed, "solver": solver.model_dump()}
    rows = known(options.out, settings)
    for index in reversed(range(options.objects)):  # the stiffest first
        if index in (row.index for row in rows) or index not in (options.only or range(options.objects)):
            continue
        case, family = draw(options.seed, index, options.objects, solver)
        rows.append(measure(index, case, family, solver, falls=options.falls))
        print(json.dumps(asdict(rows[-1])), flush=True)
        store(rows, options.out, settings)
    if rows:
        store(rows, options.out, settings)


def known(path: Path, settings: dict[str, object]) -> list[Offset]:
    """Cases that an earlier run with the same settings measured."""
    if not path.is_file():
        return []
    tree = json.loads(path.read_text())
    return [Offset(**case) for case in tree["cases"]] if tree.get("settings") == settings else []


def store(rows: list[Offset], path: Path, settings: dict[str, object]) -> None:
    """Rows and their summary with the command that made them."""
    rows = sorted(rows, key=lambda row: row.index)
    e = np.array([r.offset_log10_youngs_modulus for r in rows])
    nu = np.array([r.offset_poisson_ratio for r in rows])
    summary = {
        "mean_offset_log10_youngs_modulus": float(e.mean()),
        "median_absolute_offset_log10_youngs_modulus": float(np.median(np.abs(e))),
        "mean_offset_poisson_ratio": float(nu.mean()),
        "median_absolute_offset_poisson_ratio": float(np.median(np.abs(nu))),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    command = "python " + " ".join([f"benchmarks/{Path(__file__).name}", *sys.argv[1:]])
    tree = {"command": command, "settings": settings, "summary": summary, "cases": [asdict(r) for r in rows]}
    path.write_text(json.dumps(tree, indent=1))


if __name__ == "__main__":
    main()
