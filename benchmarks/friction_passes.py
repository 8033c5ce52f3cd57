"""Cost and accuracy of friction that is frozen to a linear drag in each step, against many passes and small steps.

python benchmarks/friction_passes.py
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from data_gen import random_object
from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import TetMesh, tetrahedralize_implicit

RESULT = Path(__file__).parent / "results" / "friction_passes.json"
# (steps per frame, passes, tolerance); the first is the reference of its stiffness
SETTINGS = ((96, 24, 1e-6), (24, 1, 5e-5), (24, 2, 5e-5), (24, 4, 5e-5), (24, 12, 5e-5), (24, 12, 1e-6), (16, 12, 5e-5))


@dataclass(frozen=True)
class Row:
    """One setting: cost, and rms distance to the reference over all nodes and 24 frames [m] (body of 1 m)."""

    youngs_modulus: float
    steps_per_frame: int
    friction_passes: int
    tolerance: float
    seconds: float
    newton_iterations: int
    factorisations: int
    rms: float


def main() -> None:
    """Run all settings and store the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    torch.set_num_threads(1)
    thing = random_object(np.random.default_rng(0))
    surface = (thing.vertices, thing.faces)
    mesh = tetrahedralize_implicit(thing.signed_distance, thing.bounds, surface=surface, max_nodes=500, order=2)
    mesh = TetMesh(mesh.vertices + np.array([0, 0, 0.5 - mesh.vertices[:, 2].min()]), mesh.tets)
    rows = []
    for youngs_modulus in (3e4, 1e6):
        body = ElasticBody(mesh, youngs_modulus=youngs_modulus, poisson_ratio=0.4)
        scene = Scene(body, obstacles=(Plane(friction=0.5),), damping_time=1e-3)
        reference = None
        for steps, passes, tolerance in SETTINGS:
            clock = time.perf_counter()
            run = simulate(scene, Timing(steps_per_frame=steps, friction_passes=passes, tolerance=tolerance))
            seconds = time.perf_counter() - clock
            reference = run.positions if reference is None else reference
            rms = float(np.sqrt(((run.positions - reference) ** 2).sum(-1).mean()))
            cost = run.statistics
            rows.append(
                Row(youngs_modulus, steps, passes, tolerance, seconds, cost.newton_iterations, cost.factorisations, rms)
            )
            print(rows[-1], flush=True)
    RESULT.parent.mkdir(parents=True, exist_ok=True)
    content = {"command": "python benchmarks/friction_passes.py", "rows": [asdict(row) for row in rows]}
    RESULT.write_text(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
