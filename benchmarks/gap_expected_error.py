"""What the gap diagnosis expects to err by, beside what the base model does err by, on captures without an effect.

python benchmarks/gap_expected_error.py BANK/captures/capture_001 ... [--out RESULT.json]

Prints, over the size of the body, the rms of the base model's residual and of the expected error on held-out frames:
with the numerical differences as they are, and with what `physconvex.gap.trust` believes of them. With the captures of
`physconvex evaluate gap generate --effect-free 1` (another engine) the residual is the model's real error and noise.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from physconvex.capture import load_capture
from physconvex.gap.baseline import Baseline, fit_baseline, rough_baseline
from physconvex.gap.effects import choose
from physconvex.gap.mapping import as_reduced
from physconvex.gap.numerics import correction_of, error_model, numerical_differences
from physconvex.gap.options import GapOptions
from physconvex.gap.score import ErrorModel
from physconvex.gap.screening import screen
from physconvex.gap.trust import error_scale


def row(base: Baseline, errors: ErrorModel) -> dict[str, float]:
    """Rms on held-out frames over the size of the body."""
    rows, size = base.rows(base.split.held_out), base.situation.size
    squares = base.components * base.lengths[rows] ** 2
    residual = base.residual(base.positions)[rows]
    return {
        "residual": float(np.sqrt((residual**2 * squares).mean()) / size),
        "expected": float(np.sqrt((errors.expected[rows] * squares).mean()) / size),
    }


def compared(folder: Path) -> dict[str, object]:
    """Both error models of one capture, and the effect that screening ranks first."""
    options, capture = GapOptions(), load_capture(folder)

    def report(_: str) -> None:
        pass

    rough = rough_baseline(capture, options, report)
    numerics = numerical_differences(rough, options, report)
    variance = error_model(rough, numerics, options).variance
    base = fit_baseline(rough, correction_of(numerics), numerics.fine, variance, options, report)
    errors = error_model(base, numerics, options)
    whole = row(base, errors)
    scale = error_scale(base, errors, screen(as_reduced(base), errors, numerics, choose(), report))
    errors = error_model(base, numerics, options, scale=scale)
    fine = None if base.model.mesh is None else (base.model.mesh, base.motion)
    base = fit_baseline(base, correction_of(numerics), fine, errors.variance, options, report)
    errors = error_model(base, numerics, options, scale=scale)
    screening = screen(as_reduced(base), errors, numerics, choose(), report)
    first = screening.one_per_name[0]
    chance = min(first.score.p_value * len(screening.ranked), 1.0)
    return {"capture": str(folder), "as_it_is": whole, "scale": scale, "believed": row(base, errors),
            "first": first.effect.label, "chance": chance}  # fmt: skip


def main() -> None:
    """Every capture, one line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    found = []
    for folder in arguments.captures:
        result = compared(folder)
        found.append(result)
        print(json.dumps(result), flush=True)
        if arguments.out is not None:
            arguments.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
