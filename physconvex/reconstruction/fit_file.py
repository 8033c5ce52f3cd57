"""The state of a fit in one file, from which a stopped run continues."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from physconvex.convex import FreeParameters
from physconvex.errors import InputError
from physconvex.reconstruction.field_fit import FitState
from physconvex.reconstruction.row_adam import RowAdam

NAMES = tuple(entry.name for entry in fields(FreeParameters))


def save_fit(state: FitState, path: Path, *, claim: str) -> None:
    """Write the state under its name atomically; `claim` identifies the fit."""
    tensors = {"fixed": state.fixed, "losses": torch.tensor(state.losses, dtype=torch.float64, device="cpu")}
    groups = {"": state.parameters.tensors(), "first.": state.adam.first, "second.": state.adam.second}
    for prefix, group in groups.items():
        tensors |= {prefix + name: value.detach().contiguous() for name, value in zip(NAMES, group, strict=True)}
    numbers = {
        "claim": claim,
        "footprint": state.footprint,
        "surface_known": state.surface_known,
        "step": state.step,
        "seconds": state.seconds,
        "adam_steps": state.adam.steps,
    }
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        save_file(tensors, partial, metadata={"state": json.dumps(numbers)})
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def load_fit(path: Path, *, claim: str) -> FitState | None:
    """The state in a file; None without a file.

    Raises:
        InputError: the file belongs to another claim, or is not from `save_fit`.
    """
    if not path.exists():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            numbers = json.loads((file.metadata() or {})["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        groups = [[tensors[prefix + name] for name in NAMES] for prefix in ("", "first.", "second.")]
    except (SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path}: no state of a reconstruction ({error}); remove it, or start anew with redo"
        ) from None
    if numbers["claim"] != claim:
        raise InputError(
            f"{path}: belongs to another capture or other settings; choose another folder, or start anew with redo"
        )
    return FitState(
        FreeParameters(*(tensor.requires_grad_() for tensor in groups[0])),
        RowAdam(groups[1], groups[2], numbers["adam_steps"]),
        tensors["fixed"],
        numbers["footprint"],
        numbers["surface_known"],
        numbers["step"],
        numbers["seconds"],
        tensors["losses"].tolist(),
    )
