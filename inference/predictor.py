"""Predict the elastic constants of one clip."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, cast

from inference.loading import LoadedClip, load_array, load_clip
from inference.prediction import Prediction
from inference.preparation import Predictor, ready_clip, to_prediction
from inference.settings import StatedConditions
from inference.sources import ClipSource, SourceProblem, displayed_path, source_at
from physconvex import InputError


def predict(
    path_or_array: str | os.PathLike[str] | Any,
    *,
    fps: float | None = None,
    density: float | None = None,
    object_size: float | None = None,
    mask: Any = None,
    timestamps: Any = None,
    predictor: Predictor | None = None,
    checkpoint: str | os.PathLike[str] = "default",
    device: str = "cpu",
) -> Prediction:
    """Predict Young's modulus, Poisson's ratio and skinning weights from one clip.

    Args:
        path_or_array: a video file, a capture folder (`capture.json`), a folder of numbered images, or frames
            of shape [T, H, W, 3 or 4] as numpy array or torch tensor, uint8 or floating point in [0, 1]
            (a fourth channel is alpha, unless it is opaque everywhere).
        fps: frames per second of the motion [1/s]. None: the file's; 24 for arrays and images without one.
        density: density [kg/m³]. None: the capture's, else 1000.
        object_size: largest edge of the object's rest bounding box [m]. None: that of the capture's mesh,
            else 1.
        mask: boolean foreground of shape [T, H, W]. None: the file's alpha or mask, else the found one.
        timestamps: times of the frames [s], shape [T], increasing; for arrays of variable rate. If `fps` is given too,
            they are stretched to that mean rate, like those of a file.
        predictor: a loaded predictor; None loads `checkpoint` (and keeps the last one for later calls).
        checkpoint: name or folder of a checkpoint.
        device: torch device of the network, such as "cpu" or "cuda".

    Returns:
        The prediction; defaults that were assumed are named in its `assumed`.

    Raises:
        InputError: an argument or the clip is wrong; the message names it, the cause and the remedy.
    """
    settings = StatedConditions(fps=fps, density=density, object_size=object_size)
    source, loaded = _load(path_or_array, mask=mask, timestamps=timestamps)
    if predictor is None:
        predictor = load_predictor(os.fspath(checkpoint), device)
    ready = replace(ready_clip(loaded, settings, predictor.prepare), source=source)
    conditions = ready.conditions
    estimates = predictor.estimate([ready.prepared], density=[conditions.density], object_size=[conditions.object_size])
    return to_prediction(ready, estimates[0])


@lru_cache(maxsize=1)
def load_predictor(checkpoint: str = "default", device: str = "cpu") -> Predictor:
    """Return the predictor of a checkpoint; the last one is kept.

    Raises:
        InputError: there is no such checkpoint or device.
    """
    from models import PhysicsPredictor

    return cast(Predictor, PhysicsPredictor.from_pretrained(checkpoint, device=device))


def _load(path_or_array: Any, *, mask: Any, timestamps: Any) -> tuple[ClipSource | None, LoadedClip]:
    if not isinstance(path_or_array, str | os.PathLike):
        _refuse_others(path_or_array)
        return None, load_array(path_or_array, mask=mask, timestamps=timestamps)
    if timestamps is not None:
        raise InputError("timestamps is given for a file; expected None, since files have their own. Leave it out.")
    source = source_at(path_or_array)
    if isinstance(source, SourceProblem):
        raise InputError(f"{displayed_path(source.path)}: {source.cause}")
    loaded = load_clip(source)
    if mask is not None:
        loaded = loaded.with_mask(mask)
    return source, loaded


def _refuse_others(given: object) -> None:
    """Check that `given` may be the frames of one clip.

    Raises:
        InputError: it holds paths, or is no array.
    """
    if not isinstance(given, Sequence | set | frozenset) and not hasattr(given, "__array__"):
        raise InputError(
            f"path_or_array: got {given!r}; expected the path of a clip, or its frames as an array [T, H, W, 3 or 4]."
        )
    if isinstance(given, list | tuple | set | frozenset) and any(isinstance(one, str | os.PathLike) for one in given):
        raise InputError(
            f"path_or_array: got {len(given)} paths; expected one clip. Use `physconvex.predict_batch(paths, out=…)`, "
            "which predicts several."
        )
