"""Time of the screening of a diagnosis: from its first effect to the first fit that follows.

python benchmarks/gap_screening.py [CAPTURE ...]

The diagnosis ends there. `before` is the time of the earlier steps: rough fits, expected errors, the base fit. The
results of `gap_silicone_beam.py` and of blind banks (`seconds`, by capture) have the time of complete diagnoses.
"""

from __future__ import annotations

import argparse
import json
import time
from contextlib import suppress
from pathlib import Path

import torch

from physconvex.gap import diagnose
from physconvex.io import load_capture

RESULT = Path(__file__).parent / "results" / "gap_screening.json"
CAPTURES = Path(__file__).parents[1] / "examples" / "captures"


class _ScreenedError(Exception):
    """Stops the diagnosis after the screening."""


def screening_seconds(capture: Path) -> dict[str, float]:
    """Clock time before and during the screening [s], and the number of effects tried, forms included."""
    start, begun, effects = time.perf_counter(), 0.0, 0

    def on_progress(text: str) -> None:
        nonlocal begun, effects
        if text.startswith("screening:"):
            begun, effects = begun or time.perf_counter(), effects + 1
        elif effects:
            raise _ScreenedError

    with suppress(_ScreenedError):
        diagnose(load_capture(capture), on_progress=on_progress)
    return {"before": round(begun - start, 1), "screening": round(time.perf_counter() - begun, 1), "effects": effects}


def main() -> None:
    """Time the captures one after the other and store the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", type=Path)
    captures = parser.parse_args().captures or sorted(path.parent for path in CAPTURES.glob("*/capture.json"))
    torch.set_num_threads(1)
    found = {}
    for capture in captures:
        found[capture.name] = screening_seconds(capture)
        print(capture.name, found[capture.name], flush=True)
    RESULT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
