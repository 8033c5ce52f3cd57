"""How near refinement comes to the truth: |Δlog10 E|, |Δν| and coverage of the 90 % intervals, beside a constant guess.

python benchmarks/refine_accuracy.py --cases 6          (goes on where it stopped)

Truth: quadratic finite elements on a finer mesh of the same body (2,025 and 2,431 nodes; the model begins with 275 and
175), with half the time step of the model's, the floor acting on points all over the block's surface. Two scenes: a bar
clamped at one end that swings (no contact: the truth converges), and a block that is thrown onto a tilted, rough floor.
Twenty markers on the surface, noise in each coordinate (--noise, metres), 12 of 16 frames are fitted; damping is
unknown, and for the block the initial velocity too. E is drawn log-uniform, ν uniform.
The constant predictor says the middle of both ranges.
"""

from __future__ import annotations

import argparse
import json
import shlex
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from inference import Refinement, RefineOptions, refine
from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene, SurfacePoints
from physconvex.io import Boundary, Capture, Floor, Tracks, load_capture, save_capture
from physconvex.mesh import Embedding, TetMesh, box_mesh, to_quadratic

RESULTS = Path(__file__).parent / "results"
FPS, FRAMES, OBSERVED, MARKERS = 48.0, 16, 12, 20
MODULUS, RATIO, DAMPING = (4.3, 5.7), (0.2, 0.45), (5e-4, 2e-3)
BAR, BLOCK = (0.3, 0.1, 0.1), (0.2, 0.15, 0.12)
CELLS = {"bar": ((5, 2, 2), (12, 4, 4)), "block": ((3, 2, 2), (8, 6, 5))}  # of the model, of the truth
COARSE = {"bar": ((3, 1, 1), (12, 4, 4))}  # the truth's cells half as long as the finer model's
TRUE_STEPS = {"bar": 16, "block": 32}  # per frame; 8 and 16 of the model
FLOOR = Floor(np.zeros(3), np.array([0.12, 0.06, 1.0]), friction=0.4)
OPTIONS = RefineOptions(weights=6, max_nodes=2000, start="scan", processes=1)


@dataclass(frozen=True)
class Row:
    """One capture: truth, errors (fit less truth) of the reduced model alone and of the refinement, intervals."""

    case: int
    scene: str
    log10_youngs_modulus: float
    poisson_ratio: float
    damping_time: float
    reduced_log10_error: float
    reduced_poisson_error: float
    log10_error: float
    poisson_error: float
    full_log10_error: float
    full_poisson_error: float
    log10_noise_sigma: float
    poisson_noise_sigma: float
    log10_model_error: float | None
    poisson_model_error: float | None
    covered_log10: bool | None
    covered_poisson: bool | None
    reduced_chi_square: float
    observed_rms_mm: float | None
    future_rms_mm: float | None
    full_runs: int
    converged: bool
    process_seconds: float


@dataclass(frozen=True)
class Throw:
    """What is drawn of one case: material, initial velocity [m/s], and the seed of the pose."""

    log10_youngs_modulus: float
    poisson_ratio: float
    damping_time: float
    velocity: tuple[float, float, float]
    pose: int

    def moved(self, name: str, change: float) -> Throw:
        """The same with one number changed."""
        return replace(self, **{name: getattr(self, name) + change})


def throw_of(scene: str, rng: np.random.Generator) -> Throw:
    """Draw a case."""
    modulus, ratio = float(rng.uniform(*MODULUS)), float(rng.uniform(*RATIO))
    damping = float(np.exp(rng.uniform(*np.log(DAMPING))))
    velocity = (0.0, 0.0, 0.0) if scene == "bar" else tuple(rng.uniform([-0.2, -0.2, -0.8], [0.2, 0.2, -0.4]))
    return Throw(modulus, ratio, damping, velocity, int(rng.integers(2**32)))


def turned(scene: str, cells: tuple[int, int, int], rng: np.random.Generator) -> TetMesh:
    """The body where it starts; the block stands askew, 20 to 40 mm over the floor."""
    mesh = box_mesh(BAR if scene == "bar" else BLOCK, cells, order=1)
    if scene == "bar":
        return mesh
    axis = rng.normal(size=3)
    axis *= np.radians(rng.uniform(5, 25)) / np.linalg.norm(axis)
    x = Rotation.from_rotvec(axis).apply(mesh.vertices)
    lowest = (x @ FLOOR.normal).min()
    return TetMesh(x + FLOOR.normal * (rng.uniform(0.02, 0.04) - lowest), mesh.tets)


@dataclass(frozen=True, eq=False)
class Made:
    """A case as it was: what is true, the model's mesh, the truth's and its nodes in all frames [m], what draws on."""

    scene: str
    truth: dict[str, float]
    coarse: TetMesh
    fine: TetMesh
    mesh: TetMesh
    positions: np.ndarray
    rng: np.random.Generator

    def capture(self, folder: Path, **more: Any) -> Capture:
        """Its folder, with nothing in it yet."""
        floor = None if self.scene == "bar" else FLOOR
        return Capture(folder, FPS, FRAMES, OBSERVED, floor=floor, initial_angular_velocity=np.zeros(3), **more)

    def held(self) -> Boundary | None:
        """What holds it."""
        box = np.array([[-1e-6, -1, -1], [1e-6, 1, 1]])
        return Boundary(clamped_box=box) if self.scene == "bar" else None


def simulated(scene: str, case: int) -> Made:
    """Draw a case and simulate the truth."""
    rng = np.random.default_rng([7, case])
    throw = throw_of(scene, rng)
    truth = {name: getattr(throw, name) for name in ("log10_youngs_modulus", "poisson_ratio", "damping_time")}
    coarse, fine = (turned(scene, cells, np.random.default_rng(throw.pose)) for cells in CELLS[scene])
    mesh = to_quadratic(fine)
    body = ElasticBody(
        mesh,
        youngs_modulus=10 ** truth["log10_youngs_modulus"],
        poisson_ratio=truth["poisson_ratio"],
        density=1000.0,
    )
    held = np.flatnonzero(mesh.vertices[:, 0] < 1e-9) if scene == "bar" else None
    floor = Plane(tuple(FLOOR.point), tuple(FLOOR.normal), friction=FLOOR.friction)
    run = simulate(
        Scene(
            body,
            obstacles=() if scene == "bar" else (floor,),
            damping_time=truth["damping_time"],
            node_pins=None if held is None else NodePins(held),
            initial_velocity=throw.velocity,
            contact_points=None if scene == "bar" else SurfacePoints.of_triangles(*fine.surface),
        ),
        Timing(
            frames=FRAMES,
            fps=FPS,
            steps_per_frame=TRUE_STEPS[scene],
            contact_solver="passes" if held is not None else "condensed",
        ),
    )
    return Made(scene, truth, coarse, fine, mesh, run.positions, rng)


def make_capture(folder: Path, case: int, noise: float) -> None:
    """Simulate the truth and write the capture; what is true is stored in `truth.json`."""
    made = simulated(("bar", "block")[case % 2], case)
    surface = np.flatnonzero(made.mesh.node_areas > 0)
    rest = made.mesh.vertices[made.rng.choice(surface, MARKERS, replace=False)]
    moved = Embedding.of_points(made.mesh, rest).apply(made.positions)
    noisy = moved + made.rng.normal(scale=noise, size=moved.shape)
    tracks = Tracks(rest, noisy, np.full(noisy.shape[:2], noise))
    save_capture(made.capture(folder), tets=made.coarse, tracks=tracks, boundary=made.held(), truth=made.truth)


def measure(root: Path, case: int, noise: float) -> Row:
    """Make a capture unless it is there, refine it, compare."""
    folder = root / f"capture_{case:03d}"
    if not folder.exists():
        make_capture(folder, case, noise)
    truth = json.loads((folder / "truth.json").read_text())
    clock = time.process_time()
    found = refine(folder, out=root / f"refined_{case:03d}", options=OPTIONS)
    return row_of(case, truth, found, time.process_time() - clock)


def row_of(case: int, truth: dict[str, float], found: Refinement, seconds: float) -> Row:
    """Compare a refinement with the truth."""
    modulus, ratio = found["log10_youngs_modulus"], found["poisson_ratio"]
    names = [e.name for e in found.estimates]
    reduced = dict(zip(names, found.reduced_values, strict=True))
    full = dict(zip(names, found.full_runs[-1].values, strict=True))
    tracks = load_capture(found.path).tracks()
    distance = None if tracks is None else np.linalg.norm(found.motion.markers - tracks.positions, axis=-1)[:OBSERVED]

    def covered(name: str) -> bool | None:
        interval = found[name].interval
        return None if interval is None else bool(interval[0] <= truth[name] <= interval[1])

    return Row(
        case=case,
        scene=("bar", "block")[case % 2],
        **truth,
        reduced_log10_error=float(reduced["log10_youngs_modulus"] - truth["log10_youngs_modulus"]),
        reduced_poisson_error=float(reduced["poisson_ratio"] - truth["poisson_ratio"]),
        log10_error=modulus.value - truth["log10_youngs_modulus"],
        poisson_error=ratio.value - truth["poisson_ratio"],
        full_log10_error=float(full["log10_youngs_modulus"] - truth["log10_youngs_modulus"]),
        full_poisson_error=float(full["poisson_ratio"] - truth["poisson_ratio"]),
        log10_noise_sigma=modulus.noise_sigma,
        poisson_noise_sigma=ratio.noise_sigma,
        log10_model_error=_finite(modulus.model_error),
        poisson_model_error=_finite(ratio.model_error),
        covered_log10=covered("log10_youngs_modulus"),
        covered_poisson=covered("poisson_ratio"),
        reduced_chi_square=found.reduced_chi_square,
        observed_rms_mm=None if distance is None else 1e3 * float(np.sqrt((distance**2).mean())),
        future_rms_mm=None if distance is None else 1e3 * found.future_rms,
        full_runs=len(found.full_runs),
        converged=found.converged,
        process_seconds=round(seconds, 1),
    )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def summary(rows: list[Row]) -> dict[str, object]:
    """Mean absolute errors of the refinement, the reduced model alone and the constant guess; coverage."""
    if not rows:
        return {}

    def mean(name: str, chosen: list[Row]) -> float:
        return float(np.mean([abs(getattr(row, name)) for row in chosen]))

    out: dict[str, object] = {}
    for scene in ("bar", "block", "all"):
        chosen = [row for row in rows if scene in (row.scene, "all")]
        if not chosen:
            continue
        covered = [c for row in chosen for c in (row.covered_log10, row.covered_poisson) if c is not None]
        held = binomtest(sum(covered), len(covered)).proportion_ci(0.95) if covered else None
        out[scene] = {
            "captures": len(chosen),
            "log10_error": mean("log10_error", chosen),
            "poisson_error": mean("poisson_error", chosen),
            "reduced_alone_log10_error": mean("reduced_log10_error", chosen),
            "reduced_alone_poisson_error": mean("reduced_poisson_error", chosen),
            "full_model_of_the_first_mesh_log10_error": mean("full_log10_error", chosen),
            "full_model_of_the_first_mesh_poisson_error": mean("full_poisson_error", chosen),
            "expected_of_noise_alone_log10": float(np.sqrt(2 / np.pi)) * mean("log10_noise_sigma", chosen),
            "expected_of_noise_alone_poisson": float(np.sqrt(2 / np.pi)) * mean("poisson_noise_sigma", chosen),
            "constant_log10_error": float(np.mean([abs(r.log10_youngs_modulus - np.mean(MODULUS)) for r in chosen])),
            "constant_poisson_error": float(np.mean([abs(r.poisson_ratio - np.mean(RATIO)) for r in chosen])),
            "coverage_90": float(np.mean(covered)) if covered else None,
            "coverage_95_percent_interval": None if held is None else [held.low, held.high],
            "intervals": len(covered),
            "process_seconds": float(np.mean([row.process_seconds for row in chosen])),
        }
    return out


def main() -> None:
    """Run the cases that are not there yet, each kept in the work folder, and store the table of all."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scene", choices=("bar", "block"), help="that one alone")
    parser.add_argument("--coarse", action="store_true", help="bars of fewer cells: a truth that is much finer")
    parser.add_argument("--noise", type=float, default=2e-4)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "refine_accuracy")
    parser.add_argument("--result", default="", help="added to the name of the stored table")
    given = parser.parse_args()
    if given.coarse:
        CELLS.update(COARSE)
    name = f"{1e3 * given.noise:g}mm"
    work = given.work / name
    work.mkdir(parents=True, exist_ok=True)
    for case in range(given.first, given.cases):
        kept = work / f"row_{case:03d}.json"
        if not kept.exists() and given.scene in (None, ("bar", "block")[case % 2]):
            kept.write_text(json.dumps(asdict(measure(work, case, given.noise))))
            print(kept.read_text(), flush=True)
    told = [f"--first={given.first}"] * bool(given.first) + [f"--cases={given.cases}", f"--noise={given.noise:g}"]
    told += ["--coarse"] * given.coarse
    told += [f"--scene={given.scene}"] * bool(given.scene) + [f"--result={given.result}"] * bool(given.result)
    rows = [Row(**json.loads(path.read_text())) for path in sorted(work.glob("row_*.json"))]
    content = {
        "command": shlex.join(["python", "benchmarks/refine_accuracy.py", *told]),
        "noise_m": given.noise,
    }
    content |= {"summary": summary(rows), "rows": [asdict(row) for row in rows]}
    (RESULTS / f"refine_accuracy_{name}{given.result}.json").write_text(
        json.dumps(content, indent=1) + "\n", encoding="utf-8"
    )
    print(json.dumps(summary(rows), indent=1))


if __name__ == "__main__":
    main()
