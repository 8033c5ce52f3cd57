"""The state of a refinement, and its finished stages on disk: a stopped one continues after the last of them.

`stages/NAME.npz` holds the arrays of a stage and its key: a digest of the capture's files and of the settings. With
another key, all stages are computed anew. Fits are stored as arrays.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from inference.reconstruction import Reconstruction
from inference.refinement.options import RefineOptions
from physconvex import InputError, __version__
from physconvex.identify import Candidate, Correction, Fit, FullRun, Iteration, Parameter, RollOuts
from physconvex.io import Capture, Workers, whole_file

Arrays = dict[str, np.ndarray]
Scanned = tuple[tuple[Parameter, ...], ...]
_KEY = "stage_key"
_IN_WORDS = {  # of NAME, and of NAME_… unless that has its own
    "reconstruction": "reconstructing the body from the first frames",
    "mesh": "making the mesh",
    "comparison_mesh": "making a mesh to compare with",
    "points": "following points in the videos",
    "network": "predicting by the network",
    "convex": "fitting the convex twin to the pixels",
    "convex_motion": "predicting all frames",
    "convex_basis": "finding the weights of the convex twin",
    "convex_start": "comparing starts of the convex twin",
    "ratio": "finding what the error of Poisson's ratio does",
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
    "geometry_error": "displaced bodies, for the error of the reconstruction",
    "motion": "predicting all frames",
    "followed": "going on from where the body is seen last",
}


def stage_in_words(name: str) -> str:
    """Description of a stage, for the progress display."""
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
        on_stage: called with the name of each stage, and whether it is read from disk.

    Raises:
        InputError: the folder cannot be written.
    """

    def __init__(
        self, out: Path | None = None, key: str = "", on_stage: Callable[[str, bool], None] | None = None
    ) -> None:
        self.folder = None if out is None else out / "stages"
        self.key, self.on_stage = key, on_stage
        if self.folder is not None:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"out: {out} cannot be written ({error.strerror}); name another folder") from None

    def run(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        """The arrays of a stage: read if it is finished under this key, else computed and stored."""
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
        except (OSError, ValueError, EOFError, BadZipFile):  # a file truncated by a full disk: computed again
            return None
        return arrays if str(arrays.pop(_KEY, "")) == self.key else None

    def _write(self, name: str, arrays: Arrays) -> None:
        if self.folder is None:
            return
        with whole_file(self.folder / f"{name}.npz") as partial:
            np.savez_compressed(partial, **arrays, **{_KEY: np.array(self.key)})  # type: ignore[arg-type]


@dataclass(eq=False)
class RefinementRun:
    """A running refinement.

    Attributes:
        capture: the capture.
        options: the settings; the correction is off if the full model fails.
        stages: the finished stages.
        workers: processes for parallel work.
        warnings: notes for the user.
        reconstruction: of the body; None if its geometry is given.
        memory: the last roll-outs of full models.
    """

    capture: Capture
    options: RefineOptions = field(default_factory=RefineOptions)
    stages: Stages = field(default_factory=Stages)
    workers: Workers = field(default_factory=Workers)
    warnings: list[str] = field(default_factory=list)
    reconstruction: Reconstruction | None = None
    memory: RollOuts = field(init=False)

    def __post_init__(self) -> None:
        self.memory = RollOuts(workers=self.workers)

    def fit(self, name: str, parameters: Sequence[Parameter], compute: Callable[[], Fit]) -> Fit:
        """The fit of a stage: read if it is finished, else computed and stored."""
        return fit_of(self.stages.run(name, lambda: arrays_of_fit(compute())), parameters)


def arrays_of_scan(
    candidates: Sequence[Candidate], keep: int = 2, *, within: tuple[float, float] | None = None
) -> Arrays:
    """Pairs tried with their misfits, and the starts of the best ones, one with log10 E `within` bounds among them."""
    best = list(candidates[:keep])
    if within is not None:
        inside = [c for c in candidates if within[0] <= c.log10_youngs_modulus <= within[1]]
        best += [c for c in inside[:1] if c not in best]
    return {
        "pairs": np.array([[c.log10_youngs_modulus, c.poisson_ratio, c.misfit] for c in candidates]),
        "starts": np.array([[p.start for p in c.parameters] for c in best]),
    }


def scan_of(arrays: Arrays, parameters: Sequence[Parameter]) -> Scanned:
    """The starts, as parameters."""
    return tuple(tuple(p.at(float(v)) for p, v in zip(parameters, row, strict=True)) for row in arrays["starts"])


def arrays_of_fit(found: Fit) -> Arrays:
    """All numbers of a fit."""
    return {
        "starts": np.array([p.start for p in found.parameters]),
        "values": found.values,
        "positions": found.positions,
        "residuals": found.residuals,
        "jacobian": found.jacobian,
        "weights": found.weights,
        "history_values": np.array([i.values for i in found.history]),
        "history": np.array([[i.misfit, i.damping] for i in found.history]),
        "state": np.array([int(found.converged), found.evaluations]),
    }


def fit_of(arrays: Arrays, parameters: Sequence[Parameter]) -> Fit:
    """The fit again."""
    pairs = zip(arrays["history_values"], arrays["history"], strict=True)
    return Fit(
        tuple(replace(p, start=float(s)) for p, s in zip(parameters, arrays["starts"], strict=True)),
        arrays["values"],
        arrays["positions"],
        arrays["residuals"],
        arrays["jacobian"],
        arrays["weights"],
        tuple(Iteration(values, float(m), float(d)) for values, (m, d) in pairs),
        bool(arrays["state"][0]),
        int(arrays["state"][1]),
    )


def arrays_of_correction(found: Correction) -> Arrays:
    """The corrected fit, and the runs of the full model."""
    return arrays_of_fit(found.fit) | {
        "run_values": np.array([run.values for run in found.runs]),
        "runs": np.array([[run.misfit, run.distance] for run in found.runs]),
        "correction_converged": np.array(int(found.converged)),
    }


def runs_of(arrays: Arrays) -> tuple[FullRun, ...]:
    """The runs of the full model."""
    if "runs" not in arrays:
        return ()
    pairs = zip(arrays["run_values"], arrays["runs"], strict=True)
    return tuple(FullRun(values, float(m), float(d)) for values, (m, d) in pairs)
