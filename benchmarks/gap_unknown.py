"""Limits of the separation of unknown from known effects, from the rows of the blind banks.

python benchmarks/gap_unknown.py [--banks 2101 2201 2301 2401 2501 2601 2701]

Six scores for "none of these" are compared, on captures whose effect is removed from the dictionary and on those with
one visible effect of the dictionary. They are the disbelief in the likeliest effect (as in the tables), the part of the
held-out gap that this effect leaves, both together, the residual over the floor, the verdict alone, and the verdict
with disbelief. `constant` is the trivial score. There is also a ceiling: a removed effect counts as *followed* if
another one brings the held-out gap down to 1.5 times the floor, since nothing then shows it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from train import area_under_roc

RESULTS = Path(__file__).parent / "results"
FOLLOWED = 1.5  # over the floor of held-out frames
Row = dict[str, Any]


def number(row: Row, name: str) -> float:
    return row[name] if row[name] is not None else 0.0


def removed(row: Row) -> float:
    return max(number(row, "shrinkage"), 0.0)


def left(row: Row) -> float:
    return number(row, "gap_after") / max(number(row, "noise_floor"), 1e-9)


VERDICTS = {"effect": 0.0, "inconclusive": 1.0, "none": 1.0, "unknown": 2.0}
SCORES: dict[str, Callable[[Row], float]] = {
    "constant": lambda row: 0.0,
    "belief": lambda row: 1.0 - row["known"],
    "removed": lambda row: -removed(row),
    "belief and removed": lambda row: -row["known"] - removed(row),
    "left over the floor": left,
    "verdict": lambda row: VERDICTS[row["verdict"]],
    "verdict, then belief": lambda row: 2 * VERDICTS[row["verdict"]] - row["known"],
}


def outside(row: Row) -> bool:
    return bool(set(row["truth"]) & set(row["without"]))


def told(rows: list[Row]) -> dict[str, Any]:
    """Areas under the curve, and their maximum."""
    unknown = [row for row in rows if outside(row)]
    known = [row for row in rows if len(row["truth"]) == 1 and not outside(row)]
    followed = sum(left(row) <= FOLLOWED and removed(row) > 0.5 for row in unknown)
    areas = {name: area_under_roc([f(r) for r in unknown], [f(r) for r in known]) for name, f in SCORES.items()}
    ceiling = 1.0 - 0.5 * followed / max(len(unknown), 1)
    return {"unknown": len(unknown), "known": len(known), "followed": followed, "ceiling": ceiling, "areas": areas}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--banks", nargs="+", default=["2101", "2201", "2301", "2401", "2501", "2601", "2701"])
    banks = parser.parse_args().banks
    files = [RESULTS / f"gap_blind_{bank}.json" for bank in banks]
    rows = [row for file in files for row in json.loads(file.read_text())["rows"] if row["truth"] and not row["error"]]
    rows = [row for row in rows if row["visibility"] >= 10]
    groups = {
        "all": rows,
        "struck": [row for row in rows if row["kind"] != "clamped"],
        "held": [row for row in rows if row["kind"] == "clamped"],
    }
    found = {name: told(group) for name, group in groups.items()}
    out = {"command": f"python benchmarks/gap_unknown.py --banks {' '.join(banks)}", **found}
    (RESULTS / "gap_unknown.json").write_text(json.dumps(out, indent=1) + "\n")
    print("| area under the curve | " + " | ".join(found) + " |\n|---|" + "---|" * len(found))
    for name in SCORES:
        print(f"| {name} | " + " | ".join(f"{one['areas'][name]:.2f}" for one in found.values()) + " |")
    print("| the most, ceiling | " + " | ".join(f"{one['ceiling']:.2f}" for one in found.values()) + " |")
    counts = (f"{one['followed']} of {one['unknown']}; {one['known']}" for one in found.values())
    print("| followed by another effect; known ones | " + " | ".join(counts) + " |")


if __name__ == "__main__":
    main()
