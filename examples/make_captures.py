"""Make the captures of `examples/captures` from the recordings in `tests/data/srl_silicone_beam`.

python examples/make_captures.py [--out examples/captures]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from docs.figures.fem_cases.beam_capture import beam_capture

RECORDINGS = ("gravity", "load101")
BUNDLED = Path(__file__).parent / "captures"


def main() -> None:
    """Write one folder for each recording."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=BUNDLED)
    out = parser.parse_args().out
    for name in RECORDINGS:
        folder = out / f"silicone_beam_{name}"
        beam_capture(folder, name, frames=45, observed=30, offset_ms=-2.5, cells=(8, 2, 2))
        print(folder)


if __name__ == "__main__":
    main()
