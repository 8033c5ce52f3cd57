"""Clips prepared once, as at inference, and stored in memory-mapped arrays."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from models import MOMENT_NAMES, ClipConfig, PreparedClip, prepare_clip
from physconvex.io import end_with_parent, whole_file
from train.records import LabelledClip, dataset_checksum

_CHUNK = 8
_ARRAYS = ("windows", "mask", "moments", "valid", "fps", "confidence", "start_time")
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class PreparedClips:
    """N prepared clips; `[:, 0]` of the moments as at inference, `[:, 1]` from the true mask.

    After pickling to another process, it is reopened there from its folder.
    """

    folder: Path
    windows: UInt8[np.ndarray, "N T W W 4"]
    mask: UInt8[np.ndarray, "N T S S"]
    moments: Float32[np.ndarray, "N 2 T M"]
    valid: Bool[np.ndarray, "N T"]
    fps: Float32[np.ndarray, " N"]
    confidence: Float32[np.ndarray, " N"]
    start_time: Float32[np.ndarray, " N"]
    """[s]"""

    @classmethod
    def open(cls, folder: Path) -> PreparedClips:
        """Those that `prepare_clips` left in a folder."""
        arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in _ARRAYS}
        return cls(folder=folder, **arrays)

    def __reduce__(self) -> tuple[object, ...]:
        return PreparedClips.open, (self.folder,)

    def clip(self, index: int) -> PreparedClip:
        """One clip as `prepare_clip` gave it (its crop and warnings are not kept)."""
        return PreparedClip(
            windows=np.asarray(self.windows[index]),
            mask=np.asarray(self.mask[index]),
            moments=self.moments[index, 0],
            valid=self.valid[index],
            fps=float(self.fps[index]),
            foreground="background_model",
            confidence=float(self.confidence[index]),
            crop=(0, 0, 0),
            source_frames=int(self.valid[index].sum()),
            start_time=float(self.start_time[index]),
        )


def prepare_clips(
    clips: Sequence[LabelledClip],
    settings: ClipConfig,
    folder: Path,
    *,
    true_mask_share: float = 0.0,
    workers: int = 1,
    progress: Progress | None = None,
) -> PreparedClips:
    """Prepare every clip, or open the result of an earlier run; an interrupted run continues.

    Args:
        clips: in the order wanted.
        settings: size, length and rate.
        folder: of the caches; a hash of data, settings, and share selects the one used.
        true_mask_share: clips with their true mask, chosen by a hash of their name; the others have the result of
            `prepare_clip`, as at inference.
        workers: processes; 0 prepares in this one.
        progress: called with the number done and the total.
    """
    target = folder / _key(clips, settings, true_mask_share)
    target.mkdir(parents=True, exist_ok=True)
    arrays = _open_arrays(target, len(clips), settings)
    done = arrays.pop("done")
    todo = np.flatnonzero(~done)
    prepare = partial(_prepare_chunk, settings=settings, true_mask_share=true_mask_share)
    chunks = [todo[k : k + _CHUNK].tolist() for k in range(0, len(todo), _CHUNK)]
    if not chunks:
        return PreparedClips.open(target)
    with _mapping(workers) as mapping:
        results = mapping(prepare, [[clips[k] for k in chunk] for chunk in chunks])
        for chunk, prepared in zip(chunks, results, strict=True):
            for index, values in zip(chunk, prepared, strict=True):
                for name, value in values.items():
                    arrays[name][index] = value
            done[chunk] = True
            if progress is not None:
                progress(int(done.sum()), len(done))
    for array in (*arrays.values(), done):
        array.flush()
    return PreparedClips.open(target)


@contextmanager
def _mapping(workers: int) -> Iterator[Callable[..., Iterator[list[dict[str, object]]]]]:
    """`map`, in order, over processes or none."""
    if workers == 0:
        yield map
        return
    with ProcessPoolExecutor(workers, get_context("spawn"), _start_worker) as pool:
        yield pool.map


def _start_worker() -> None:
    """One thread in each process, and none that outlives this one."""
    import cv2
    import torch

    end_with_parent()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)


def _open_arrays(folder: Path, count: int, settings: ClipConfig) -> dict[str, np.memmap]:
    size, window, frames = settings.image_size, settings.window, settings.frames
    shapes: dict[str, tuple[tuple[int, ...], type]] = {
        "windows": ((count, frames, window, window, 4), np.uint8),
        "mask": ((count, frames, size, size), np.uint8),
        "moments": ((count, 2, frames, len(MOMENT_NAMES)), np.float32),
        "valid": ((count, frames), np.bool_),
        "fps": ((count,), np.float32),
        "confidence": ((count,), np.float32),
        "start_time": ((count,), np.float32),
        "done": ((count,), np.bool_),
    }
    arrays: dict[str, np.memmap] = {}
    for name, (shape, dtype) in shapes.items():
        path = folder / f"{name}.npy"
        if not path.is_file():
            with whole_file(path) as partial:
                np.lib.format.open_memmap(partial, mode="w+", dtype=dtype, shape=shape).flush()
        arrays[name] = np.load(path, mmap_mode="r+")
    return arrays


def _key(clips: Sequence[LabelledClip], settings: ClipConfig, true_mask_share: float) -> str:
    content = {
        "format": 4,
        "data": [dataset_checksum(folder) for folder in dict.fromkeys(clip.dataset for clip in clips)],
        "clips": [clip.name for clip in clips],
        "settings": settings.model_dump(),
        "true_mask_share": true_mask_share,
        "moments": MOMENT_NAMES,
    }
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def _prepare_chunk(
    clips: list[LabelledClip], *, settings: ClipConfig, true_mask_share: float
) -> list[dict[str, object]]:
    return [_prepare(clip, settings, true_mask_share) for clip in clips]


def _prepare(clip: LabelledClip, settings: ClipConfig, true_mask_share: float) -> dict[str, object]:
    frames, fps, truth = clip.record.frames(), clip.fps, clip.record.mask()
    known = prepare_clip(frames, fps=fps, mask=truth, config=settings)
    found = prepare_clip(frames, fps=fps, config=settings)
    draw = int.from_bytes(hashlib.sha256(clip.name.encode()).digest()[:4], "big") / 2**32
    shown = known if draw < true_mask_share else found
    return {name: getattr(shown, name) for name in _ARRAYS} | {"moments": np.stack([found.moments, known.moments])}
