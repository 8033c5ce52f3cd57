"""Run the whole product by its command line and compare its numbers with those of `tests/regression/expected`.

    python tests/regression/run.py                            # or: make regression
    python tests/regression/run.py --only predict simulate_sand
    python tests/regression/run.py --store --only predict     # today's numbers become the expected ones
    python tests/regression/run.py --checkout ../other        # measure another checkout with this one's numbers
    python tests/regression/run.py --out results --jobs 2     # keep what the commands write; two cases at once

For changes that must change no result. Compared are the numbers and words of what each case writes: those of JSON and
CSV files, and of arrays shape, largest value, root mean square, two sums and some values. They may differ by 1e-6 of
their size, those of a list or array by 1e-6 of its largest; whether nothing differs by a bit is said too. Where a
command promises the same bytes (docs/howto/data.md), the files' digests must be equal.

Exit code 0: as stored; 1: something differs or failed; 2: wrong usage. One after the other on an idle core, all take
a quarter of an hour: the diagnoses 5 minutes each, the bus 2½, the rest 2½.

The numbers belong to one kind of processor, one compiler and one set of package versions: store them anew from an
untouched checkout before measuring a change elsewhere. Every process computes with one thread and a cache of this
run's own, so neither the machine's load nor earlier meshes count; meshes are the lattice mesher's, since fTetWild does
not repeat itself. Only a diagnosis looks at the clock, to end after 840 s: the clock it gets here is slow.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from safetensors.numpy import load_file

HERE = Path(__file__).resolve().parent
TOLERANCE = 1e-6
LARGE, SHOWN, SAMPLES = 16, 20, 6  # numbers of a list that is summed up; differences printed; values kept of an array
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "MKL_CBWR": "AUTO",
    "MPLBACKEND": "Agg",
    "PYTHONDONTWRITEBYTECODE": "1",
}
# Of the machine, the clock or this run, and what was given: not compared.
IGNORED_FILES = re.compile(r"(^|/)(run\.json|timings\.jsonl|stages/.*)$")
IGNORED_NAMES = re.compile(r"seconds|version|^(path|config|configuration|options|thresholds|units?|null)$")

Leaf = float | int | str | bool | None
Leaves = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """Commands run one after the other, in the checkout; `{inputs}` and `{out}` are folders.

    With `exact` the digests of all files count too. With `slow_clock` the clock goes at a hundredth of its speed, so
    that a busy machine cuts nothing short.
    """

    commands: Sequence[str]
    exact: bool = False
    slow_clock: bool = False


_SLOW_CLOCK = "import time\n_clock = time.monotonic\ntime.monotonic = lambda: _clock() / 100\n"
_SMALL = (
    "--seed 3 --workers 1 --no-progress --set solver.target_nodes=250 --set solver.landing_nodes=80"
    " --set video.frames=10 --set motion.drop_height=[0.05,0.1]"
)
_RING = "--count 1 --markers 6 --set camera.views=5 --set video.width=96 --set video.height=96"
_PLAY = "--size 0.5 --no-ply --no-progress --set basis.mesher=lattice"
_BEAM = "examples/captures/silicone_beam"
CASES = {
    "diagnose_gravity": Case([f"diagnose {_BEAM}_gravity --no-progress --out {{out}}"], slow_clock=True),
    "diagnose_load101": Case([f"diagnose {_BEAM}_load101 --no-progress --out {{out}}"], slow_clock=True),
    "refine_beam": Case(
        [f"refine {_BEAM}_gravity --fix poisson_ratio=0.49 --processes 2 --no-progress --out {{out}}"],
    ),
    "refine_bus": Case(  # without the finer mesh of the last searches, which is fTetWild's
        ["refine examples/captures/school_bus --fine-nodes 0 --processes 1 --no-progress --out {out}"]
    ),
    "predict": Case(  # clips that are ready go into one batch, which by rounding depends on the clock
        ["predict examples/clips --batch-size 1 --no-progress --out {out}"]
    ),
    "simulate_plasticine": Case(
        [f"simulate {{inputs}}/ring.obj --preset plasticine --frames 14 {_PLAY} --out {{out}}"],
    ),
    "simulate_sand": Case(
        [f"simulate {{inputs}}/ball.obj --preset sand --frames 12 --set object.drop_height=0.1 {_PLAY} --out {{out}}"]
    ),
    "simulate_push": Case(  # its basis takes two roll-outs of the full-order model
        [f"simulate {{inputs}}/ball.obj --preset push --basis elastic --frames 12 {_PLAY} --out {{out}}"]
    ),
    "simulate_pile": Case(
        [
            "simulate {inputs}/box.obj {inputs}/ring.obj {inputs}/ball.obj --preset moving_floor --frames 9"
            " --set 1:material.law=corotated --set 2:material.kind=viscoelastic --set 2:material.modulus_ratio=1.5"
            " --set 2:material.relaxation_time=0.1 --set 3:material.stiffening=2 --set 3:forces.wind=[2,0,0]"
            f" --modes 6 {_PLAY} --out {{out}}"
        ]
    ),
    "generate_dataset": Case([f"generate dataset --count 2 --set camera.views=2 {_SMALL} --out {{out}}"], exact=True),
    "generate_captures": Case(
        [
            f"generate captures {_RING} {_SMALL} --set solver.contact_solver=passes --set solver.touching=surface"
            " --out {out}"
        ],
        exact=True,
    ),
    "generate_falls": Case(  # in the place of `generate benchmark`, whose meshes are fTetWild's
        ["generate falls --shapes 1 --each 2 --nodes 300 --seed 5 --workers 1 --no-progress --out {out}"], exact=True
    ),
    "reconstruct": Case(
        [
            f"generate captures {_RING} {_SMALL} --out {{out}}/made",
            "reconstruct {out}/made/000000 --start hull --budget 300 --steps 30 --no-progress --out {out}/field",
        ]
    ),
}


def main() -> int:
    """Run, and compare or store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=CASES, default=list(CASES))
    parser.add_argument("--list", action="store_true", help="names of the cases, nothing else")
    parser.add_argument("--store", action="store_true", help="write the expected numbers instead of comparing")
    parser.add_argument("--checkout", type=Path, default=HERE.parents[1], help="whose code runs")
    parser.add_argument("--expected", type=Path, default=HERE / "expected", help="folder of the expected numbers")
    parser.add_argument("--out", type=Path, help="new folder of what the commands write; default: one that is removed")
    parser.add_argument("--jobs", type=int, default=1, help="cases at once")
    given = parser.parse_args()
    if given.list:
        print(*CASES, sep="\n")
        return 0
    with tempfile.TemporaryDirectory(prefix="regression_") as scratch:
        out = (given.out or Path(scratch)).resolve()
        if any((out / name).exists() for name in given.only):
            parser.error(f"--out {out}: has results already")
        make_inputs(out / "inputs")

        def one(name: str) -> bool:
            return run_case(name, out, given.checkout.resolve(), given.expected, given.store)

        with ThreadPoolExecutor(given.jobs) as pool:
            fine = list(pool.map(one, given.only))
    print(f"{sum(fine)} of {len(fine)} cases {'stored' if given.store else 'as expected'}")
    return 0 if all(fine) else 1


def make_inputs(folder: Path) -> None:
    """Meshes to play with, and a slow clock for programs whose path the folder `clock` is on."""
    (folder / "clock").mkdir(parents=True, exist_ok=True)
    (folder / "clock" / "sitecustomize.py").write_text(_SLOW_CLOCK, encoding="utf-8")
    trimesh.creation.box((0.3, 0.2, 0.12)).export(folder / "box.obj")
    trimesh.creation.icosphere(subdivisions=2, radius=0.1).export(folder / "ball.obj")
    trimesh.creation.torus(0.2, 0.09, major_sections=24, minor_sections=12).export(folder / "ring.obj")


def run_case(name: str, out: Path, checkout: Path, expected: Path, store: bool) -> bool:
    """Whether a case ran and gave what is stored, or was stored."""
    begun, folder = time.monotonic(), out / name
    problem = failure(CASES[name], folder, out, checkout)
    seconds = time.monotonic() - begun
    if problem:
        print(f"FAILED  {name}  {seconds:.1f} s\n{problem}", flush=True)
        return False
    found = leaves_of(folder, exact=CASES[name].exact)
    file = expected / f"{name}.json"
    if store:
        write_leaves(file, found)
        print(f"stored  {name}  {seconds:.1f} s  {len(found)} leaves", flush=True)
        return True
    stored = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    different = sorted(differences(stored, found), key=lambda one: -one[0])
    if different:
        verdict = f"{len(different)} differ, at most (first) by {different[0][0]:.3g}"
    else:
        verdict = "to the bit" if stored == found else f"within {TOLERANCE:g}, not to the bit"
    lines = [f"{'DIFFERS' if different else 'same   '}  {name}  {seconds:.1f} s  {len(found)} leaves, {verdict}"]
    for size, key, old, new in different[:SHOWN]:
        place, before, after = worst(old, new)
        lines.append(f"  {key}{place}: expected {before!r}, got {after!r}, relative {size:.3g}")
    print("\n".join(lines), flush=True)
    return not different


def failure(case: Case, folder: Path, out: Path, checkout: Path) -> str:
    """What a command that failed said last; empty if all went well."""
    folder.mkdir(parents=True)
    path = os.pathsep.join([str(checkout), *([str(out / "inputs" / "clock")] if case.slow_clock else [])])
    environment = {**os.environ, **ENVIRONMENT, "PYTHONPATH": path, "PHYSCONVEX_CACHE": str(out / "cache")}
    for command in case.commands:
        words = [word.format(inputs=out / "inputs", out=folder) for word in command.split()]
        done = subprocess.run(
            [sys.executable, "-m", "physconvex", *words], cwd=checkout, env=environment, capture_output=True, text=True
        )
        if done.returncode != 0:
            return f"exit code {done.returncode}: {command}\n{(done.stdout + done.stderr)[-3000:]}"
    return ""


def leaves_of(folder: Path, *, exact: bool) -> Leaves:
    """All that is compared of the files of a folder, by file and name."""
    found: Leaves = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        if IGNORED_FILES.search(name):
            continue
        if exact:
            found[f"{name}#sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        for key, value in leaves(content_of(path)):
            found[f"{name}:{key}"] = value
    return json.loads(json.dumps(found, default=float))  # as they come back from a file


def write_leaves(file: Path, found: Leaves) -> None:
    """One a line, in order."""
    file.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"{json.dumps(key, ensure_ascii=False)}: {json.dumps(found[key])}" for key in sorted(found)]
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def content_of(path: Path) -> Any:
    """What a file holds, as dicts, lists, arrays, numbers and words; nothing of files of other kinds."""
    if path.suffix == ".json":
        return json.loads(path.read_text(encoding="utf-8"))
    if path.suffix == ".csv":
        with path.open(encoding="utf-8", newline="") as file:
            return [{name: as_number(text) for name, text in row.items()} for row in csv.DictReader(file)]
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)
    if path.suffix == ".safetensors":
        return load_file(path)
    return convexes_in(path) if path.suffix == ".ply" else {}


def convexes_in(path: Path) -> dict[str, np.ndarray]:
    """The numbers of a convex field, a row for each property; nothing of other PLY files."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    if b"element convex" not in head:
        return {}
    names = re.findall(rb"property float (\w+)", head)
    return {"convexes": np.frombuffer(body, dtype="<f4").reshape(-1, len(names)).T}


def as_number(text: str) -> Leaf:
    """A number if it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers, words and short lists of numbers with their names; of long ones and of arrays a summary."""
    if isinstance(value, dict):
        for key, part in value.items():
            if not IGNORED_NAMES.search(key):
                yield from leaves(part, f"{name}.{key}" if name else key)
    elif isinstance(value, np.ndarray) and numbers_in(value) is None:
        yield from leaves(value.tolist(), name)
    elif isinstance(value, list | np.ndarray):
        array = numbers_in(value)
        if array is not None and (array.size > LARGE or isinstance(value, np.ndarray)):
            yield f"{name}.shape", str(array.shape)
            yield f"{name}.bits", hashlib.sha256(array.tobytes()).hexdigest()[:12]
            yield f"{name}.sums", sums(array.ravel())
        elif array is not None and array.ndim == 1:
            yield name, array.tolist()
        elif len(value) > LARGE and all(isinstance(part, dict) and part.keys() == value[0].keys() for part in value):
            yield from leaves({key: [part[key] for part in value] for key in value[0]}, f"{name}[]")  # a table
        else:
            for number, part in enumerate(value):
                yield from leaves(part, f"{name}[{number}]")
    else:
        yield name, value


def numbers_in(value: Any) -> np.ndarray | None:
    """A list or array of numbers alone, as float64."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of different lengths
        return None
    return array.astype(np.float64) if array.dtype.kind in "iufb" and array.size else None


def sums(values: np.ndarray) -> list[float]:
    """Largest value, root mean square, mean, mean with changing signs, and some of the values, which are finite."""
    known = np.where(np.isfinite(values), values, 0.0)
    signs = np.cos(np.arange(known.size))
    chosen = known[np.linspace(0, known.size - 1, SAMPLES).astype(int)]
    return [np.abs(known).max(), np.sqrt((known**2).mean()), known.mean(), (signs * known).mean(), *chosen]


def differences(expected: Leaves, found: Leaves) -> Iterator[tuple[float, str, Any, Any]]:
    """Relative size (infinite of what is missing or no number), name, and both values of what differs; not of bits."""
    for key in sorted(expected.keys() | found.keys()):
        old, new = expected.get(key, "nothing"), found.get(key, "nothing")
        if not key.endswith(".bits") and not (size := distance(old, new)) <= TOLERANCE:
            yield size, key, old, new


def distance(old: Any, new: Any) -> float:
    """Largest difference of two numbers or lists of numbers, relative to the largest of them."""
    if old == new:
        return 0.0
    first, second = numbers_in([old]), numbers_in([new])
    if first is None or second is None or first.shape != second.shape or isinstance(old, bool):
        return math.inf
    if np.array_equal(first, second, equal_nan=True):
        return 0.0
    gap, size = np.abs(first - second).max(), np.abs(first).max()
    return float(gap / size) if gap < np.inf and size > 0 else math.inf


def worst(old: Any, new: Any) -> tuple[str, Any, Any]:
    """Of two lists the place and the values of the largest difference; of other things these."""
    if not (isinstance(old, list) and isinstance(new, list) and len(old) == len(new)):
        return "", old, new
    place = int(np.argmax(np.abs(np.subtract(old, new))))
    return f"[{place}]", old[place], new[place]


if __name__ == "__main__":
    sys.exit(main())
