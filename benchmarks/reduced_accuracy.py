"""The reduced model against the full model over bodies: rms distance, and the bias of E and ν when it is fitted to it.

python benchmarks/reduced_accuracy.py --data DATA --minutes 15

Bodies of 0.2 m dropped from 5 cm on a tilted floor, or stretched and let go in free space, 24 frames at 48 per second;
both models on the same quadratic mesh, with the same steps and contact, so that a row shows the reduction alone (the
"paper" rows: M = 10 neural field and also implicit Euler with one step per 1/24 s). DATA holds the folders meshes/ and
gso/ with NAME/model.obj; bodies that are not there are left out. Rows are stored as they are made, in the order of
`cases`; a run goes on where the last one ended. The full model's motions are kept in the cache folder. `--only BODY`
picks bodies; `--nodes 2500` takes finer meshes, `--steps 32` finer steps, `--drop 0.01` a lower drop; each stores a
file of its own, such as reduced_accuracy_2500_nodes.json.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

from data_gen import FLAT, DrawnSurface, rendered_frames
from inference import predict
from physconvex import ConvergenceError, InputError
from physconvex.dynamics import Plane, Timing, simulate, simulate_with_sensitivities
from physconvex.fem import ElasticBody, Scene
from physconvex.io import look_at
from physconvex.kernels import cache_folder
from physconvex.mesh import TetMesh, box_mesh, tetrahedralize
from physconvex.reduced import (
    BodySamples,
    NamedParameters,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    WeightField,
    eigenmode_weights,
    elastic_weights,
    even_loads,
    parameter_values,
    predicted_weights,
    snapshot_weights,
    train_neural_weights,
    with_elastic_weights,
    with_parameters,
)

RESULTS = Path(__file__).parent / "results"
SIZE, DROP, NODES = 0.2, 0.05, 700
BODIES = (
    "cube",
    "bar",
    "meshes/spot",
    "meshes/koala_lowres",
    "gso/Kong_Puppy_Teething_Rubber_Small_Pink",
    "gso/Android_Figure_Orange",
)
NORMAL = np.array([0.15, 0.05, 1.0]) / np.linalg.norm([0.15, 0.05, 1.0])
TIMING = Timing(frames=24, fps=48.0)
STEPS = 8  # per frame
PAPER = Timing(frames=12, fps=24.0, steps_per_frame=1, integrator="implicit_euler")
PULL = np.array([[1.25, 0.15, 0.0], [0.0, 0.9, 0.1], [0.1, 0.0, 0.95]])
NAMES = ("log10_youngs_modulus", "poisson_ratio")
ITERATIONS, LARGEST_STEP, SETTLED = 8, 0.15, 1e-3


@dataclass(frozen=True)
class Case:
    """One setting: body, E [Pa], ν, basis and number of weights, and what happens to the body.

    basis: elastic (vibrations and answers to forces where the floor touches, found by two roll-outs, the first one with
    20 eigenmodes; on patches where nothing touches), eigenmodes, neural, predicted (by the bundled checkpoint from a
    film of the full motion, as many as it has handles), snapshots, or paper. Elastic weights are interpolated at nodes.
    scene: "drop", or "release" (stretched, sheared, let go in free space).
    """

    body: str
    youngs_modulus: float
    poisson_ratio: float
    basis: str
    weights: int
    scene: str = "drop"


@dataclass(frozen=True)
class Row:
    """Distances over nodes and frames [m] (root mean square), biases (fit minus truth), cost.

    `motion` is the rms distance from the start; `last_step` the last change of the fit; `failure` why there is no fit.
    """

    case: Case
    nodes: int
    motion: float
    rms_at_truth: float
    rms_fitted: float
    bias_log10_youngs_modulus: float
    bias_poisson_ratio: float
    last_step: float
    seconds: float
    failure: str = ""


def cases(bodies: list[str]) -> Iterator[Case]:
    """The most telling first."""
    grid = [(e, nu) for nu in (0.3, 0.45) for e in (3e5, 3e4, 3e6)]
    for modulus, ratio in grid:
        for body in bodies:
            yield Case(body, modulus, ratio, "elastic", 60)
    for modulus, ratio in grid[:2] + grid[3:5]:
        for body in bodies:
            yield Case(body, modulus, ratio, "elastic", 60, "release")
    for modulus, ratio in grid:
        for body in bodies:
            yield Case(body, modulus, ratio, "elastic", 30)
    for modulus, ratio in ((3e5, 0.3), (3e5, 0.45), (3e4, 0.3), (3e4, 0.45)):
        for body in bodies:
            yield Case(body, modulus, ratio, "eigenmodes", 10, "release")
    first = [("eigenmodes", 10), ("paper", 10), ("eigenmodes", 20)]
    rest = [("elastic", 10), ("neural", 10), ("eigenmodes", 40), ("eigenmodes", 4), ("snapshots", 10)]
    last = [("eigenmodes", m) for m in (8, 12)] + [
        (b, m) for b in ("elastic", "neural", "snapshots") for m in (4, 8, 12, 20, 40)
    ]
    for stage in (first, rest, [("predicted", 10)], last):
        for modulus, ratio in grid:
            for body in bodies:
                for basis, count in stage:
                    yield Case(body, modulus, ratio, basis, count)


@dataclass(frozen=True)
class Study:
    """What all rows share: where the surfaces are, most nodes of a mesh, steps per frame, height of the drop [m]."""

    data: Path
    nodes: int = NODES
    steps: int = STEPS
    drop: float = DROP

    @property
    def changes(self) -> dict[str, float]:
        """What is not as usual."""
        usual = asdict(Study(self.data))
        return {name: value for name, value in asdict(self).items() if value != usual[name]}

    @property
    def name(self) -> str:
        """What tells it from the usual one, for names of files."""
        return "".join(f"_{value:g}_{name}" for name, value in self.changes.items())

    @property
    def timing(self) -> Timing:
        """Of all but the paper's rows."""
        return replace(TIMING, steps_per_frame=self.steps)

    @property
    def result(self) -> Path:
        """Where the rows are stored."""
        return RESULTS / f"reduced_accuracy{self.name}.json"


@cache
def mesh_of(name: str, study: Study) -> TetMesh:
    """Quadratic mesh of a body, its largest edge 0.2 m; kept, since not every mesher repeats itself."""
    cells = round((study.nodes / NODES) ** (1 / 3))  # along each edge for one of the usual mesh
    if name == "cube":
        return box_mesh((SIZE,) * 3, (3 * cells,) * 3, order=2)
    if name == "bar":
        return box_mesh((SIZE, SIZE / 3, SIZE / 3), (6 * cells, 2 * cells, 2 * cells), order=2)
    finer = "" if study.nodes == NODES else f"-{study.nodes}"
    kept = cache_folder() / "reduced_accuracy" / f"{name.replace('/', '-')}{finer}.npz"
    if kept.is_file():
        with np.load(kept) as arrays:
            return TetMesh(arrays["vertices"], arrays["tets"])
    mesh = _mesh_file(name, study)
    kept.parent.mkdir(parents=True, exist_ok=True)
    np.savez(kept, vertices=mesh.vertices, tets=mesh.tets)
    return mesh


def _mesh_file(name: str, study: Study) -> TetMesh:
    """Mesh of a body given as a surface."""
    import trimesh

    surface = trimesh.load_mesh(study.data / name / "model.obj", process=True)
    vertices = np.asarray(surface.vertices) * (SIZE / np.ptp(surface.vertices, axis=0).max())
    if name.startswith("meshes"):  # y is up
        vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    return tetrahedralize((vertices, np.asarray(surface.faces)), order=2, max_nodes=study.nodes, method="auto")


def floor_under(mesh: TetMesh, study: Study) -> Plane:
    """The tilted floor under the body."""
    return Plane(point=((mesh.vertices @ NORMAL).min() - study.drop) * NORMAL, normal=NORMAL)


def full_motion(case: Case, mesh: TetMesh, study: Study, *, softer: float = 1.0) -> np.ndarray:
    """Positions of the nodes at the frames [m], shape [T, V, 3], of the case's body or a softer one."""
    modulus, ratio, scene = case.youngs_modulus / softer, case.poisson_ratio, case.scene
    key = f"{case.body.replace('/', '-')}-{len(mesh.vertices)}-{modulus:.3g}-{ratio:.3g}"
    timed = replace(study, nodes=NODES).name  # the number of nodes is in the key
    path = cache_folder() / "reduced_accuracy" / f"{key}{'' if scene == 'drop' else '-' + scene}{timed}.npy"
    if not path.is_file():
        body = ElasticBody(mesh, youngs_modulus=modulus, poisson_ratio=ratio)
        full = Scene(body, obstacles=(floor_under(mesh, study),))
        if scene == "release":
            full = Scene(body, gravity=(0, 0, 0), initial_positions=mesh.vertices @ PULL.T)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, simulate(full, study.timing).positions)
    return np.load(path)


def reduced_scene(case: Case, mesh: TetMesh, study: Study) -> ReducedScene:
    """The reduced body of a case and what happens to it."""
    if case.basis == "elastic" and case.scene == "drop":
        rough = reduced_scene(replace(case, basis="eigenmodes", weights=20), mesh, study)
        return with_elastic_weights(rough, mesh, case.weights, study.timing)
    samples = BodySamples.of_mesh(mesh)
    space = ReducedSpace(weights_of(case, mesh, study), samples, interpolated=case.basis == "elastic")
    body = ReducedBody(space, youngs_modulus=case.youngs_modulus, poisson_ratio=case.poisson_ratio)
    if case.scene == "release":
        return ReducedScene(body, gravity=(0, 0, 0), initial_coordinates=space.affine(PULL, np.zeros(3)))
    stiffness = 50 * case.youngs_modulus / mesh.size
    return ReducedScene(body, obstacles=(floor_under(mesh, study),), contact_stiffness=stiffness)


@cache
def neural_weights(name: str, count: int, study: Study) -> WeightField:
    """The data-free field of a body of one material does not depend on its stiffness."""
    samples = BodySamples.of_mesh(mesh_of(name, study))
    return train_neural_weights(samples, count, generator=torch.Generator().manual_seed(0))


def weights_of(case: Case, mesh: TetMesh, study: Study) -> WeightField:
    """The basis of a case; snapshots come from a body half as stiff."""
    if case.basis == "elastic":
        return elastic_weights(ElasticBody(mesh), case.weights, even_loads(mesh, 20))
    if case.basis == "eigenmodes":
        return eigenmode_weights(ElasticBody(mesh), case.weights)
    if case.basis == "predicted":
        return weights_from_film(mesh, full_motion(case, mesh, study))
    if case.basis == "snapshots":
        softer = full_motion(case, mesh, study, softer=2)
        return snapshot_weights(ElasticBody(mesh), [softer - mesh.vertices], case.weights)
    return neural_weights(case.body, case.weights, study)


def weights_from_film(mesh: TetMesh, motion: np.ndarray) -> WeightField:
    """What the bundled checkpoint predicts from a film of a motion: from the front, 224², coloured by chance."""
    nodes, faces = np.unique(mesh.boundary_faces[:, :3], return_inverse=True)
    colours = np.random.default_rng(0).integers(40, 220, (len(nodes), 3)).astype(np.uint8)
    surface = DrawnSurface(mesh.vertices[nodes], faces.reshape(-1, 3), colors=colours)
    low, high = motion.min((0, 1)), motion.max((0, 1))
    centre = (low + high) / 2
    camera = look_at(centre - [0, 5 * SIZE, 0], centre, width=224, height=224, vertical_field_of_view=0.45)
    film = np.stack(rendered_frames(surface, camera, FLAT, motion[:, nodes]))
    prediction = predict(film, fps=TIMING.fps, object_size=SIZE)
    rest = mesh.vertices
    return predicted_weights(prediction.skinning_field, origin=(rest.min(0) + rest.max(0)) / 2)


class Fit:
    """Levenberg–Marquardt from the truth."""

    def __init__(self, scene: ReducedScene, mesh: TetMesh, observed: np.ndarray, timing: Timing) -> None:
        self.scene, self.points, self.observed, self.timing = scene, mesh.vertices, observed, timing
        self.values = parameter_values(scene, NAMES)
        self.last_step = np.inf
        self.distances: list[float] = []

    def at(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian."""
        run = simulate_with_sensitivities(
            NamedParameters(with_parameters(self.scene, NAMES, values), NAMES), self.timing
        )
        residual = (run.trajectory.positions(self.points) - self.observed).ravel()
        return residual, np.moveaxis(run.trajectory.carried(self.points, run.coordinate_tangents), 1, -1).reshape(
            len(residual), -1
        )

    def run(self) -> None:
        """Iterate until the change is small."""
        residual, jacobian = self.at(self.values)
        self.distances.append(rms(residual))
        damping = 1e-6
        for _ in range(ITERATIONS):
            normal = jacobian.T @ jacobian
            step = np.linalg.solve(normal + damping * np.diag(normal.diagonal()), -jacobian.T @ residual)
            moved = self.values + np.clip(step, -LARGEST_STEP, LARGEST_STEP)
            moved[1] = np.clip(moved[1], -0.2, 0.49)
            self.last_step = float(np.abs(moved - self.values).max())
            if self.last_step < SETTLED:
                break
            trial, slope = self.at(moved)
            if rms(trial) < self.distances[-1]:
                self.values, residual, jacobian, damping = moved, trial, slope, damping / 10
                self.distances.append(rms(residual))
            else:
                damping = max(damping, 1e-3) * 30


def rms(residual: np.ndarray) -> float:
    """Root mean square length of the vectors in a flat residual."""
    return float(np.sqrt((residual**2).mean() * 3))


def measure(case: Case, study: Study) -> Row:
    """One row."""
    clock = time.process_time()
    mesh = mesh_of(case.body, study)
    observed = full_motion(case, mesh, study)
    paper = case.basis == "paper"
    observed = observed[::2] if paper else observed
    motion = rms((observed - mesh.vertices).ravel())
    fit, bias, failure = None, np.full(2, np.nan), ""
    try:
        fit = Fit(reduced_scene(case, mesh, study), mesh, observed, PAPER if paper else study.timing)
        truth = fit.values
        fit.run()
        bias = fit.values - truth
    except (ConvergenceError, InputError) as error:  # a motion may hold fewer independent snapshots than weights
        failure = str(error)
    distances = (fit and fit.distances) or [np.nan]
    return Row(
        case, len(mesh.vertices), motion, distances[0], distances[-1], float(bias[0]), float(bias[1]),
        fit.last_step if fit else np.inf, time.process_time() - clock, failure,
    )  # fmt: skip


def load_rows(study: Study) -> list[Row]:
    """What earlier runs stored."""
    if not study.result.is_file():
        return []
    return [Row(**{**row, "case": Case(**row["case"])}) for row in json.loads(study.result.read_text())["rows"]]


def store(rows: list[Row], study: Study) -> None:
    """All rows, and how to make them."""
    options = "".join(f" --{name} {value:g}" for name, value in study.changes.items())
    command = f"python benchmarks/reduced_accuracy.py --data DATA{options}"
    study.result.write_text(json.dumps({"command": command, "rows": [asdict(row) for row in rows]}, indent=1) + "\n")


def main() -> None:
    """Go on with the table until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder with meshes/ and gso/")
    parser.add_argument("--minutes", type=float, default=np.inf, help="no further row is begun after that")
    parser.add_argument("--only", nargs="*", help="bodies, by default all")
    parser.add_argument("--nodes", type=int, default=NODES, help="most nodes of the meshes made from surfaces")
    parser.add_argument("--steps", type=int, default=STEPS, help="time steps per frame, but for the paper's rows")
    parser.add_argument("--drop", type=float, default=DROP, help="height above the floor [m]")
    options = parser.parse_args()
    torch.set_num_threads(1)
    study = Study(options.data, options.nodes, options.steps, options.drop)
    bodies = [b for b in options.only or BODIES if "/" not in b or (options.data / b / "model.obj").is_file()]
    rows, end = load_rows(study), time.monotonic() + 60 * options.minutes
    done = {row.case for row in rows}
    for case in cases(bodies):
        if case not in done and time.monotonic() < end:
            rows.append(measure(case, study))
            store(rows, study)
            print(rows[-1], flush=True)


if __name__ == "__main__":
    main()
