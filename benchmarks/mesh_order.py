"""How fast meshes of quadratic elements converge where nothing is struck: bars of the accuracy benchmark, halved twice.

python benchmarks/mesh_order.py

With x₀, x₁, x₂ the markers' positions on the first mesh and with all edges halved once and twice, the ratio
r = |x₂ − x₁| / |x₁ − x₀| is what a halving leaves of a difference; of x₁ − x₀ then r/(1 − r) is left in x₁ if it goes
on so. An eighth would be the third order that smooth displacements have, a seventh what is left.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
from refine_accuracy import make_capture, throw_of

from physconvex.identify import FullModel, TwinOptions, base_twin
from physconvex.io import load_capture
from physconvex.mesh import refine_uniformly as subdivided

RESULT = Path(__file__).parent / "results" / "mesh_order.json"
CASES, SHOWN = (0, 12, 22, 28), 8
NAMES = ("log10_youngs_modulus", "poisson_ratio", "damping_time")


def measure(root: Path, case: int) -> dict[str, object]:
    """The ratio of one bar, by frame and in all."""
    if not root.exists():
        make_capture(root, CASES[0], 2e-4)
    capture = load_capture(root)
    tracks = capture.tracks()
    assert tracks is not None
    throw = throw_of("bar", np.random.default_rng([7, case]))
    values = np.array([getattr(throw, name) for name in NAMES])
    twin = base_twin(capture, TwinOptions(6, 2000, None))
    meshes = [twin.mesh, subdivided(twin.mesh)]
    meshes.append(subdivided(meshes[1]))
    x = [FullModel(twin, NAMES, tracks.rest, SHOWN, mesh).positions(values) for mesh in meshes]
    first, second = (np.square(b - a).sum((1, 2))[1:] for a, b in pairwise(x))
    ratio = float(np.sqrt(second.sum() / first.sum()))
    return {
        "case": case,
        **dict(zip(NAMES, values.tolist(), strict=True)),
        "nodes": [len(mesh.vertices) for mesh in meshes],
        "ratio_by_frame": np.sqrt(second / first).round(3).tolist(),
        "ratio": round(ratio, 3),
        "left_of_the_first_difference": round(ratio / (1 - ratio), 3),
        "order": round(float(-np.log2(ratio)), 2),
    }


def main() -> None:
    """Measure and store."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(Path(folder) / "bar", case) for case in CASES]
    content = {"command": "python benchmarks/mesh_order.py", "frames": SHOWN, "rows": rows}
    RESULT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
