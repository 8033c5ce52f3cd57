"""Make the captures of `examples/captures`: recordings of a beam (`tests/data/srl_silicone_beam`), and a film of a toy.

    python examples/make_captures.py [--objects FOLDER] [--out examples/captures]

FOLDER holds Google Scanned Objects, one folder each with `model.obj` and `texture.png`; without it the toy is left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from data_gen import BenchmarkOptions, drop_object
from docs.figures.fem_cases.beam_capture import beam_capture

RECORDINGS = ("gravity", "load101")
BUNDLED = Path(__file__).parent / "captures"
TOY = "SCHOOL_BUS"
TRUTH = {"youngs_modulus": 10**5.3, "poisson_ratio": 0.40, "damping_time": 1e-3}


def main() -> None:
    """Write one folder for each recording, and one for the toy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path)
    parser.add_argument("--out", type=Path, default=BUNDLED)
    given = parser.parse_args()
    for name in RECORDINGS:
        folder = given.out / f"silicone_beam_{name}"
        beam_capture(folder, name, frames=45, observed=30, offset_ms=-2.5, cells=(8, 2, 2))
        print(folder)
    if given.objects is not None:
        options = BenchmarkOptions(size=224, views=2, nodes=1000, fill=False, steps_per_frame=24)
        model = given.objects / TOY / "model.obj"
        folder, _ = drop_object(given.out / TOY.lower(), model, TRUTH, options, np.random.default_rng(2))
        (given.out / f"{TOY.lower()}_motion.npz").unlink()  # the answer
        print(folder)


if __name__ == "__main__":
    main()
