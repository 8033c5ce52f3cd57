"""A bar clamped at one end falls under its own weight: the reduced model's distance to the full one, by basis.

python benchmarks/reduced_clamped.py

0.3 m × 0.06 m × 0.06 m, E = 0.1 MPa, ν = 0.4, quadratic tetrahedra; 24 frames at 48 per second, 8 steps each, the same
steps in both. "even": elastic weights of the free bar that answer to loads all over the surface; "held": those of the
clamped one; "rolled": `with_elastic_weights`, also about the states of a roll-out. Stores results/reduced_clamped.json.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from physconvex.dynamics import Pins, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene
from physconvex.mesh import box_mesh
from physconvex.reduced import (
    BodySamples,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    eigenmode_weights,
    elastic_weights,
    even_loads,
    with_elastic_weights,
)

RESULT = Path(__file__).parent / "results" / "reduced_clamped.json"
TIMING = Timing(frames=24, fps=48.0, steps_per_frame=8)


def main() -> None:
    """All rows."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    torch.set_num_threads(1)
    mesh = box_mesh((0.3, 0.06, 0.06), (9, 2, 2), order=2)
    full = ElasticBody(mesh, youngs_modulus=1e5, poisson_ratio=0.4)
    clamped = np.isclose(mesh.vertices[:, 0], mesh.vertices[:, 0].min())
    truth = simulate(Scene(full, node_pins=NodePins(np.flatnonzero(clamped))), TIMING).positions
    samples = BodySamples.of_mesh(mesh)
    space = ReducedSpace(eigenmode_weights(full, 20), samples, interpolated=True)
    body = ReducedBody(space, youngs_modulus=1e5, poisson_ratio=0.4)
    pins = Pins(mesh.vertices[clamped], np.maximum(mesh.node_areas[clamped], 1e-9))
    rough = ReducedScene(body, pins=pins)
    rows = []
    for count in (6, 10, 20, 30, 40):
        fields = {
            "eigenmodes": eigenmode_weights(full, count),
            "even": elastic_weights(full, count, even_loads(mesh, 20)),
            "held": elastic_weights(full, count, clamped=clamped),
            "rolled": with_elastic_weights(rough, mesh, count, TIMING).body.space.field,
        }
        for name, field in fields.items():
            scene = replace(rough, body=body.with_space(ReducedSpace(field, samples, interpolated=True)))
            distance = simulate(scene, TIMING).positions(mesh.vertices) - truth
            rms = float(np.sqrt((distance**2).sum(2).mean()))
            rows.append({"weights": count, "basis": name, "rms": rms})
            print(rows[-1], flush=True)
    motion = float(np.sqrt(((truth - mesh.vertices) ** 2).sum(2).mean()))
    result = {"command": "python benchmarks/reduced_clamped.py", "nodes": len(mesh.vertices), "motion": motion}
    RESULT.write_text(json.dumps({**result, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
