"""Refinement from the video of one camera: a textured body that falls on a rough floor, made by the generator.

python benchmarks/refine_video.py          (goes on where it stopped)

The rest geometry is the generator's own mesh (257 nodes), so that this measures what the images, the search and the
correction lose, and no difference of meshes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import torch

from data_gen.captures import RingOptions, capture_folder, generate_captures
from data_gen.config import load_config
from inference.refining import RefineOptions, refine, write_refinement

RESULT = Path(__file__).parent / "results" / "refine_video.json"
CONFIG = [
    "video={frames: 18, width: 224, height: 224, supersampling: 2}",
    "solver={target_nodes: 300, steps_per_frame: 16}",
    "camera.views=2",
    "motion.drop_height=[0.2, 0.4]",
    "motion.size=[1.0,1.0]",
    "motion.initial_spin=[0.0,0.6]",
    "material.youngs_modulus=[1e5,2e5]",
    "material.damping_time=[1e-3,1e-3]",
    "samples={points: 8, modes: 2}",
]
OPTIONS = RefineOptions(
    observations="video",
    cameras=("camera0",),
    weights=8,
    max_nodes=300,
    steps_per_frame=8,
    start="scan",
    full_runs=3,
    model_error=False,
)


def main() -> None:
    """Make the capture unless it is there, refine it, store truth and result."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "refine_video")
    root = parser.parse_args().work
    rings = RingOptions(observed_frames=12, markers=25, marker_noise=1e-3)
    generate_captures(
        root / "captures", count=1, config=load_config("captures", overrides=CONFIG), seed=5, options=rings
    )
    folder = capture_folder(root / "captures", 0)
    found = refine(folder, out=root / "refined", options=OPTIONS)
    write_refinement(found, root / "refined", options=OPTIONS)
    truth = json.loads((folder / "truth.json").read_text())
    names = [e.name for e in found.estimates]
    result = {
        "command": "python benchmarks/refine_video.py",
        "truth": {name: truth[name] for name in ("youngs_modulus", "poisson_ratio", "damping_time")},
        "log10_error": float(np.log10(found.youngs_modulus / truth["youngs_modulus"])),
        "poisson_error": found.poisson_ratio - truth["poisson_ratio"],
        "reduced_alone": dict(zip(names, map(float, found.reduced_values), strict=True)),
        "refinement": {k: v for k, v in found.to_json().items() if k not in ("history", "path")},
    }
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(result["log10_error"], result["poisson_error"])


if __name__ == "__main__":
    main()
