"""The data set on disk (docs/architecture.md): writing one simulation at a time, and reading.

`index.parquet` has one row per clip with every number of its simulation and view; `manifest.json` the SHA-256 of every
file. Both are made from the simulation folders, so a data set that was cut off can be finished at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, UInt8

from data_gen.simulate import Samples
from physconvex.errors import InputError
from physconvex.video import read_video

__all__ = [
    "FORMAT_VERSION",
    "ClipRecord",
    "Dataset",
    "RenderedView",
    "finish_dataset",
    "simulation_folder",
    "write_simulation",
]

FORMAT_VERSION = 1
SPLITS = ("train", "validation", "test")


@dataclass(frozen=True, eq=False)
class RenderedView:
    """One clip: encoded video, object mask [T, H, W], and what view.json tells."""

    video: bytes
    mask: Bool[np.ndarray, "T H W"]
    metadata: dict[str, Any]


def simulation_folder(root: Path, simulation: int) -> Path:
    """Where simulation number `simulation` lies."""
    return root / "simulations" / f"{simulation:06d}"


def write_simulation(
    root: Path, simulation: int, metadata: dict[str, Any], samples: Samples, views: list[RenderedView]
) -> None:
    """Write one simulation folder; it appears under its name only when it is complete."""
    final = simulation_folder(root, simulation)
    partial = final.with_name(f".partial-{final.name}")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    _write_json(partial / "simulation.json", metadata)
    np.savez(
        partial / "samples.npz",
        points=samples.points.astype(np.float32),
        volume_weights=samples.volume_weights.astype(np.float32),
        displacements=samples.displacements.astype(np.float32),
        modes=samples.modes.astype(np.float32),
        eigenvalues=samples.eigenvalues.astype(np.float32),
    )
    for number, view in enumerate(views):
        (partial / f"view{number}.mp4").write_bytes(view.video)
        np.savez(
            partial / f"view{number}_mask.npz", mask=np.packbits(view.mask, axis=-1), shape=np.array(view.mask.shape)
        )
        _write_json(partial / f"view{number}.json", view.metadata)
    shutil.rmtree(final, ignore_errors=True)
    partial.rename(final)


def _write_json(path: Path, content: Any) -> None:
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(content, indent=1, sort_keys=True), encoding="utf-8")
    os.replace(partial, path)


def finish_dataset(root: Path, configuration: dict[str, Any], seed: int, version: str) -> None:
    """Write `index.parquet` and `manifest.json` over all simulation folders that are there."""
    folders = sorted(p for p in (root / "simulations").iterdir() if not p.name.startswith("."))
    rows = [row for folder in folders for row in _rows(folder)]
    if not rows:
        raise InputError(f"{root}: no finished simulation; nothing to index")
    partial = root / "index.parquet.partial"
    pq.write_table(pa.Table.from_pylist(rows), partial)
    os.replace(partial, root / "index.parquet")
    failures = sum(int(json.loads((f / "simulation.json").read_text())["attempt"]) for f in folders)
    files = {str(f.relative_to(root)): _sha256(f) for folder in folders for f in sorted(folder.iterdir())}
    manifest = {
        "format_version": FORMAT_VERSION,
        "generator_version": version,
        "seed": seed,
        "configuration": configuration,
        "simulations": len(folders),
        "clips": len(rows),
        "failed_simulations": failures,
        "failure_share": failures / (failures + len(folders)),
        "files": files | {"index.parquet": _sha256(root / "index.parquet")},
    }
    _write_json(root / "manifest.json", manifest)


def _rows(folder: Path) -> Iterator[dict[str, Any]]:
    simulation = json.loads((folder / "simulation.json").read_text())
    for path in sorted(folder.glob("view*.json")):
        view = json.loads(path.read_text())
        scalars = _flat(simulation) | {f"view_{k}": v for k, v in _flat(view).items()}
        number = int(path.stem.removeprefix("view"))
        yield scalars | {"clip_id": f"{folder.name}_{number}", "folder": folder.name, "view": number}


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Numbers and names of a nested dictionary; lists become one column each."""
    out: dict[str, Any] = {}
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
    def camera_to_world(self) -> np.ndarray:
        """Camera-to-world matrix, shape [4, 4]."""
        view = json.loads((self.folder / f"view{self.view}.json").read_text())
        return np.array(view["camera"]["transform_matrix"])


@dataclass(frozen=True, eq=False)
class Dataset:
    """A finished data set: its folder, its manifest and one record per clip."""

    root: Path
    manifest: dict[str, Any]
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
