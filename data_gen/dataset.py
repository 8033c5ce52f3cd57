"""The data set on disk (docs/reference/data_sets.md): writing one simulation at a time, and reading.

`index.parquet` has one row per clip with every number of its simulation and view. `manifest.json` has the SHA-256 of
every file. Both are made from the simulation folders, so that an interrupted data set can be finished at any time.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, UInt8
from pydantic import JsonValue

from data_gen.simulate import Samples
from physconvex import InputError
from physconvex.io import Camera, read_video, whole_file, write_json

FORMAT_VERSION = 1
SPLITS = ("train", "validation", "test")


@dataclass(frozen=True, eq=False)
class RenderedView:
    """One clip: encoded video, object mask [T, H, W], and the content of view.json."""

    video: bytes
    mask: Bool[np.ndarray, "T H W"]
    metadata: dict[str, JsonValue]


def simulation_folder(root: Path, simulation: int) -> Path:
    """Folder of simulation number `simulation`."""
    return root / "simulations" / f"{simulation:06d}"


def is_settled(root: Path, simulation: int) -> bool:
    """Whether that simulation is there, or was given up."""
    return simulation_folder(root, simulation).is_dir() or _given_up_file(root, simulation).is_file()


def _given_up_file(root: Path, simulation: int) -> Path:
    return root / "given_up" / f"{simulation:06d}.json"


def write_claim(root: Path, claim: Mapping[str, object]) -> None:
    """Record in `generator.json` the settings of the folder, or check that they are the same.

    Raises:
        InputError: the folder was begun with something else.
    """
    path = root / "generator.json"
    if path.exists():
        found = json.loads(path.read_text(encoding="utf-8"))
        different = [key for key in claim if found.get(key) != claim[key]]
        if different:
            raise InputError(
                f"out: {root} was begun with another {', '.join(different)}; expected the same, or a new folder"
            )
        return
    root.mkdir(parents=True, exist_ok=True)
    write_json(path, claim, sort_keys=True)


def write_given_up(root: Path, simulation: int, failures: list[str]) -> None:
    """Record that all attempts at a simulation failed, so that it is not tried again."""
    path = _given_up_file(root, simulation)
    path.parent.mkdir(exist_ok=True)
    write_json(path, {"simulation": simulation, "failures": failures}, sort_keys=True)


def write_simulation(
    root: Path, simulation: int, metadata: dict[str, JsonValue], samples: Samples, views: list[RenderedView]
) -> None:
    """Write one simulation folder atomically."""
    final = simulation_folder(root, simulation)
    partial = final.with_name(f".partial-{final.name}")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    write_json(partial / "simulation.json", metadata, sort_keys=True)
    np.savez(partial / "samples.npz", **{name: value.astype(np.float32) for name, value in vars(samples).items()})
    for number, view in enumerate(views):
        (partial / f"view{number}.mp4").write_bytes(view.video)
        np.savez(
            partial / f"view{number}_mask.npz",
            mask=np.packbits(view.mask, axis=-1),
            shape=np.array(view.mask.shape),
        )
        write_json(partial / f"view{number}.json", view.metadata, sort_keys=True)
    shutil.rmtree(final, ignore_errors=True)
    partial.rename(final)


def finish_dataset(root: Path, configuration: dict[str, JsonValue], seed: int, version: str) -> tuple[int, ...]:
    """Write `index.parquet`, `failures.jsonl` and `manifest.json` for all existing simulations.

    Returns:
        Numbers of the abandoned simulations.

    Raises:
        InputError: no simulation succeeded.
    """
    folders = sorted((root / "simulations").glob("[0-9]*"))
    rows = [row for folder in folders for row in _rows(folder)]
    failures, given_up = _failures(root, folders)
    with whole_file(root / "failures.jsonl") as partial:
        partial.write_text("".join(json.dumps(failure) + "\n" for failure in failures), encoding="utf-8")
    if not rows:
        raise InputError(f"{root}: no simulation succeeded ({failures[-1]['message'] if failures else 'none tried'})")
    with whole_file(root / "index.parquet") as partial:
        pq.write_table(pa.Table.from_pylist(rows), partial)
    files = {str(f.relative_to(root)): _sha256(f) for folder in folders for f in sorted(folder.iterdir())}
    files |= {name: _sha256(root / name) for name in ("index.parquet", "failures.jsonl")}
    manifest = {
        "format_version": FORMAT_VERSION,
        "generator_version": version,
        "seed": seed,
        "configuration": configuration,
        "simulations": len(folders),
        "clips": len(rows),
        "failed_simulations": len(failures),
        "failure_share": len(failures) / (len(failures) + len(folders)),
        "given_up": given_up,
        "files": files,
    }
    write_json(root / "manifest.json", manifest, sort_keys=True)
    return tuple(given_up)


def _failures(root: Path, folders: list[Path]) -> tuple[list[dict[str, JsonValue]], list[int]]:
    """Every failed attempt, and the simulations of which all attempts failed."""
    given_up = [json.loads(p.read_text(encoding="utf-8")) for p in sorted((root / "given_up").glob("*.json"))]
    made = [json.loads((folder / "simulation.json").read_text(encoding="utf-8")) for folder in folders]
    notes = [
        {"simulation": entry["simulation"], "attempt": attempt, "message": message}
        for entry in [*made, *given_up]
        for attempt, message in enumerate(entry.get("failures", []))
    ]
    return notes, [entry["simulation"] for entry in given_up]


def _rows(folder: Path) -> Iterator[dict[str, JsonValue]]:
    simulation = json.loads((folder / "simulation.json").read_text())
    simulation.pop("failures", None)
    for path in sorted(folder.glob("view*.json")):
        view = json.loads(path.read_text())
        scalars = _flat(simulation) | {f"view_{k}": v for k, v in _flat(view).items()}
        number = int(path.stem.removeprefix("view"))
        yield scalars | {"clip_id": f"{folder.name}_{number}", "folder": folder.name, "view": number}


def _flat(tree: dict[str, JsonValue], prefix: str = "") -> dict[str, JsonValue]:
    """Numbers and names of a nested dictionary; lists become one column each."""
    out: dict[str, JsonValue] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            out |= _flat(value, f"{prefix}{key}_")
        else:
            out[prefix + key] = json.dumps(value) if isinstance(value, list) else value
    return out


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True, eq=False)
class ClipRecord:
    """One clip of a data set; arrays are read on access.

    Attributes:
        folder: the simulation's folder.
        view: number of the view.
        row: the clip's row of the index: every number of simulation.json and (with prefix `view_`) of view.json.
    """

    folder: Path
    view: int
    row: dict[str, Any]

    @property
    def clip_id(self) -> str:
        """Name of the clip, unique in its data set."""
        return str(self.row["clip_id"])

    @property
    def video_path(self) -> Path:
        """The video file."""
        return self.folder / f"view{self.view}.mp4"

    def frames(self) -> UInt8[np.ndarray, "T H W 3"]:
        """Decoded video, RGB."""
        return read_video(self.video_path).frames

    def mask(self) -> Bool[np.ndarray, "T H W"]:
        """True where the object is seen."""
        with np.load(self.folder / f"view{self.view}_mask.npz") as data:
            count, height, width = data["shape"]
            return np.unpackbits(data["mask"], axis=-1, count=width).reshape(count, height, width).astype(bool)

    def samples(self) -> Samples:
        """Interior points, displacements and skinning eigenmodes of the simulation (float32)."""
        with np.load(self.folder / "samples.npz") as data:
            return Samples(**{name: data[name] for name in Samples.__dataclass_fields__})

    @cached_property
    def camera(self) -> Camera:
        """The camera of this view."""
        view = json.loads((self.folder / f"view{self.view}.json").read_text(encoding="utf-8"))
        return Camera.from_json(view["camera"])


@dataclass(frozen=True, eq=False)
class Dataset:
    """A finished data set: its folder, its manifest and one record per clip."""

    root: Path
    manifest: dict[str, JsonValue]
    clips: tuple[ClipRecord, ...]

    @classmethod
    def open(cls, path: str | Path, *, split: str | None = None) -> Dataset:
        """Read the index of a data set.

        Raises:
            InputError: no data set there, another format version, or an unknown split.
        """
        root = Path(path)
        if split is not None and split not in SPLITS:
            raise InputError(f"split: got {split!r}; expected one of {', '.join(SPLITS)}")
        if not (root / "manifest.json").is_file():
            raise InputError(
                f"data set: {root} has no manifest.json; expected a folder made by `physconvex generate dataset` "
                "(run it again with the same arguments to finish one that was cut off)"
            )
        manifest = json.loads((root / "manifest.json").read_text())
        if manifest["format_version"] != FORMAT_VERSION:
            raise InputError(
                f"data set: {root} has format version {manifest['format_version']}; expected {FORMAT_VERSION}"
            )
        rows = pq.read_table(root / "index.parquet").to_pylist()
        clips = (
            ClipRecord(root / "simulations" / row["folder"], row["view"], row)
            for row in rows
            if split is None or row["split"] == split
        )
        return cls(root, manifest, tuple(clips))

    def verify(self) -> list[str]:
        """Names of the files that are missing or whose checksum differs from the manifest's."""
        files = cast(dict[str, str], self.manifest["files"])
        return [n for n, h in files.items() if not (self.root / n).is_file() or _sha256(self.root / n) != h]

    def __len__(self) -> int:
        return len(self.clips)
