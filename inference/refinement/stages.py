"""Finished stages on disk: a refinement that was stopped goes on after the last of them.

`stages/NAME.npz` holds the arrays of a stage and the key it was made under: a digest of the capture's files and of the
settings. Another key makes all stages anew.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from physconvex import InputError, __version__

__all__ = ["Arrays", "Stages", "key_of", "stage_in_words"]

Arrays = dict[str, np.ndarray]
_KEY = "stage_key"
_IN_WORDS = {  # of NAME, and of NAME_… unless that has its own
    "points": "following points in the videos",
    "scan": "scanning Young's modulus",
    "reduced": "fitting the reduced model",
    "coarse": "fitting the full model on few nodes",
    "drift_limit": "bounding rigid drift by two meshes",
    "drift": "looking for rigid drift after a contact",
    "start": "comparing starts",
    "frame_errors": "comparing few nodes with more",
    "anchored": "following the points again from the model",
    "reduced_again": "fitting the reduced model again",
    "correction": "correcting with the full model",
    "fine": "fitting on more nodes",
    "fine_mesh": "making a mesh of more nodes",
    "colours": "comparing colours",
    "elsewhere": "comparing colours of other rebounds",
    "field": "fitting a convex field to the first images",
    "model_error": "finer model, for the error that is left",
    "motion": "predicting all frames",
}


def stage_in_words(name: str) -> str:
    """What a stage does, for who waits for it."""
    return _IN_WORDS.get(name) or _IN_WORDS.get(name.partition("_")[0], name)


def key_of(folder: Path, settings: Mapping[str, Any]) -> str:
    """Digest of the files of a capture (but the truth) and of settings."""
    digest = hashlib.sha256(json.dumps([__version__, settings], sort_keys=True, default=list).encode())
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != "truth.json":
            digest.update(str(path.relative_to(folder)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:24]


class Stages:
    """The stages of one refinement.

    Args:
        out: the result folder; None keeps nothing.
        key: of capture and settings.
        on_stage: told the name of each stage, and whether it was read again.

    Raises:
        InputError: the folder cannot be written.
    """

    def __init__(self, out: Path | None, key: str, on_stage: Callable[[str, bool], None] | None = None) -> None:
        self.folder = None if out is None else out / "stages"
        self.key, self.on_stage = key, on_stage
        if self.folder is not None:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"out: {out} cannot be written ({error.strerror}); name another folder") from None

    def run(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        """The arrays of a stage: read again if it was finished under this key, else computed and stored."""
        stored = self._read(name)
        if self.on_stage is not None:
            self.on_stage(name, stored is not None)
        if stored is not None:
            return stored
        arrays = compute()
        self._write(name, arrays)
        return arrays

    def known(self, name: str) -> bool:
        """Whether a stage can be read again."""
        return self._read(name) is not None

    def _read(self, name: str) -> Arrays | None:
        if self.folder is None or not (path := self.folder / f"{name}.npz").exists():
            return None
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                arrays = {entry: archive[entry] for entry in archive.files}
        except (OSError, ValueError, EOFError, BadZipFile):  # a file cut short by a full disk: made anew
            return None
        return arrays if str(arrays.pop(_KEY, "")) == self.key else None

    def _write(self, name: str, arrays: Arrays) -> None:
        if self.folder is None:
            return
        partial = self.folder / f".{name}.{os.getpid()}.npz"
        np.savez_compressed(partial, **arrays, **{_KEY: np.array(self.key)})  # type: ignore[arg-type]
        os.replace(partial, self.folder / f"{name}.npz")
