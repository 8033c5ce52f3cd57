"""A predictor without a network, for tests of everything around it: E and ν follow from silhouettes."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save_file

from models import ClipConfig, PreparedClip, prepare_clip


@dataclass(frozen=True)
class FieldDouble:
    """Skinning weights that depend on the first coordinate."""

    scale: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return np.stack([points[:, 0] * self.scale, 1 - points[:, 0] * self.scale], axis=1)

    def save(self, path: str | Path) -> None:
        save_file({"scale": np.array([self.scale])}, str(path))


@dataclass(frozen=True)
class EstimateDouble:
    """One estimate."""

    youngs_modulus: float
    poisson_ratio: float
    log10_youngs_modulus_std: float
    poisson_ratio_std: float
    youngs_modulus_interval: tuple[float, float]
    poisson_ratio_interval: tuple[float, float]
    skinning_field: FieldDouble
    warnings: tuple[str, ...] = ()


@dataclass
class PredictorDouble:
    """E = 1e5 · density/1000 · size · height of the path; ν from the number of valid frames."""

    pause: float = 0.0  # [s] per batch
    fail_on: str = ""  # "nan" or "raise": what happens to clips that are red
    config: str = "double"
    network: torch.nn.Module = field(default_factory=torch.nn.Identity)
    batches: list[int] = field(default_factory=list)
    clip_config: ClipConfig = field(default_factory=lambda: ClipConfig(image_size=32, frames=12))
    threads: set[str] = field(default_factory=set)

    def prepare(self, frames: np.ndarray, **options: Any) -> PreparedClip:
        self.threads.add(threading.current_thread().name)
        return prepare_clip(frames, config=self.clip_config, **options)

    def estimate(
        self, clips: Sequence[PreparedClip], *, density: Sequence[float], object_size: Sequence[float]
    ) -> list[EstimateDouble]:
        self.batches.append(len(clips))
        time.sleep(self.pause)
        return [self._one(*values) for values in zip(clips, density, object_size, strict=True)]

    def _one(self, clip: PreparedClip, density: float, object_size: float) -> EstimateDouble:
        height = 1.0 + abs(float(clip.moments[:, 1].min()))
        youngs_modulus = 1e5 * density / 1000 * object_size * height * (clip.fps / 24.0) ** 2
        inside = clip.windows[clip.windows[..., 3] > 200, :3]
        if self.fail_on and inside[:, 0].mean() > inside[:, 2].mean() + 60:
            if self.fail_on == "raise":
                raise RuntimeError("the network stumbled\nover red")
            youngs_modulus = float("nan")
        ratio = 0.2 + 0.01 * int(clip.valid.sum())
        return EstimateDouble(
            youngs_modulus=youngs_modulus,
            poisson_ratio=ratio,
            log10_youngs_modulus_std=0.1,
            poisson_ratio_std=0.02,
            youngs_modulus_interval=(youngs_modulus * 0.7, youngs_modulus * 1.4),
            poisson_ratio_interval=(ratio - 0.03, ratio + 0.03),
            skinning_field=FieldDouble(height),
        )
