"""`PhysicsPredictor`: a checkpoint with its calibration and the preparation of its clips."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, UInt8

import physconvex
from models.checkpoint import PredictorConfig, load_checkpoint
from models.checkpoint_files import save_network
from models.clip import ClipConfig, PreparedClip, prepare_clip
from models.config import NetworkConfig
from models.heads import BinnedDensity
from models.mirror import answer_both_ways
from models.network import ClipBatch, PhysicsNetwork
from models.scaling import dimensionless_interval, log10_youngs_modulus
from physconvex import InputError
from physconvex.reduced import SkinningField


@dataclass(frozen=True, kw_only=True, eq=False)
class ClipEstimate:
    """Estimate of the object's material from one clip."""

    youngs_modulus: float
    """Median [Pa]."""
    poisson_ratio: float
    """Median [1]."""
    log10_youngs_modulus_std: float
    """[decades]"""
    poisson_ratio_std: float
    youngs_modulus_interval: tuple[float, float]
    """Calibrated, 90 % [Pa]."""
    poisson_ratio_interval: tuple[float, float]
    """Calibrated, 90 %."""
    dimensionless_log10_stiffness: float
    """log10(E / (ρ g L)), median."""
    skinning_field: SkinningField
    out_of_range: bool = False
    """The clip or its stiffness is outside the checkpoint's training range."""
    warnings: tuple[str, ...] = ()


class PhysicsPredictor:
    """Clips -> Young's modulus, Poisson's ratio, skinning weights, each with its uncertainty.

    `prepare` reads a clip once; `estimate` is a batch of stateless network passes, so that preparation may run
    elsewhere.
    """

    def __init__(self, network: PhysicsNetwork, config: PredictorConfig) -> None:
        self.network = network.eval()
        self.config = config

    @classmethod
    def from_pretrained(
        cls, path_or_name: str | os.PathLike[str] = "default", *, device: str = "cpu"
    ) -> PhysicsPredictor:
        """The predictor in a checkpoint folder, or of a bundled checkpoint.

        Raises:
            InputError: there is no such checkpoint or device.
        """
        return cls(*load_checkpoint(path_or_name, device=device))

    @classmethod
    def from_config(
        cls, config: NetworkConfig | None = None, *, seed: int = 0, device: str = "cpu"
    ) -> PhysicsPredictor:
        """An untrained predictor: its answers mean nothing."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = PhysicsNetwork(config)
        return cls(network.to(device), PredictorConfig.for_network(network.config))

    def save_pretrained(self, folder: str | os.PathLike[str], *, model_card: str | None = None) -> None:
        """Write a checkpoint folder that `from_pretrained` reads."""
        config = self.config.model_copy(update={"version": physconvex.__version__})
        card = model_card or "# physconvex predictor\n\nNo model card was given; see config.json.\n"
        save_network(folder, self.network, config, model_card=card)

    @property
    def clip_config(self) -> ClipConfig:
        """Format of the clips from `prepare`."""
        return self.config.clip

    @property
    def device(self) -> torch.device:
        """Where the network runs."""
        return next(self.network.parameters()).device

    def prepare(
        self,
        frames: UInt8[np.ndarray, "T H W 3"],
        *,
        fps: float = 24.0,
        timestamps: Float64[np.ndarray, " T"] | None = None,
        mask: UInt8[np.ndarray, "T H W"] | None = None,
        alpha: UInt8[np.ndarray, "T H W"] | None = None,
    ) -> PreparedClip:
        """The network's input (`models.clip.prepare_clip` with this checkpoint's size and rate)."""
        return prepare_clip(frames, fps=fps, timestamps=timestamps, mask=mask, alpha=alpha, config=self.clip_config)

    @torch.inference_mode()
    def estimate(
        self, clips: Sequence[PreparedClip], *, density: Sequence[float], object_size: Sequence[float]
    ) -> list[ClipEstimate]:
        """One estimate per clip, in one pass of the network.

        Args:
            clips: of `prepare`.
            density: [kg/m³], one per clip.
            object_size: largest edge of the rest bounding box [m], one per clip.

        Raises:
            InputError: the lengths differ, a number is not positive, or a clip has another size or length.
        """
        if not len(clips) == len(density) == len(object_size):
            raise InputError(
                f"density, object_size: got {len(density)} and {len(object_size)} for {len(clips)} clips; "
                "expected one number per clip"
            )
        if not clips:
            return []
        densities, sizes = np.asarray(density, np.float64), np.asarray(object_size, np.float64)
        offset = log10_youngs_modulus(np.zeros(len(clips)), density=densities, object_size=sizes)
        intervals = dimensionless_interval(np.array([clip.fps for clip in clips]), object_size=sizes)
        batch = collate_clips(clips, intervals, self.clip_config).to(self.device)
        output = answer_both_ways(self.network, batch)
        calibration, network = self.config.calibration, self.config.network
        stiffness = calibration.stiffness.density(output.stiffness_logits, network.stiffness)
        poisson = calibration.poisson.density(output.poisson_logits, network.poisson)
        log_e = _summary(stiffness, *calibration.stiffness.interval(stiffness))
        nu = _summary(poisson, *calibration.poisson.interval(poisson))
        head = self.network.skinning_head
        fields = head.fields(output.latent, [float(size) for size in sizes])
        return [
            _estimate(log_e[k], float(offset[k]), nu[k], fields[k], self._warnings(intervals[k], log_e[k]))
            for k in range(len(clips))
        ]

    def _warnings(self, interval: float, log_stiffness: _Summary) -> tuple[str, ...]:
        """Warnings of values outside the training range."""
        known, warnings = self.config.training_range, []
        low, high = known.interval
        if not low / 1.05 <= interval <= high * 1.05:
            warnings.append(
                f"the frame interval is {interval:.3g} sqrt(L/g), trained on {low:.3g} to {high:.3g}: "
                "give the true fps and object size, or another frame rate"
            )
        low, high = known.log10_stiffness
        if log_stiffness.median > high - 0.1:
            warnings.append(f"stiffer than the training data tells apart (E > {10**high:.3g} rho g L)")
        elif log_stiffness.median < low + 0.1:
            warnings.append(f"softer than the training data (E < {10**low:.3g} rho g L)")
        return tuple(warnings)


@dataclass(frozen=True)
class _Summary:
    median: float
    std: float
    low: float
    high: float


def _summary(density: BinnedDensity, low: torch.Tensor, high: torch.Tensor) -> list[_Summary]:
    columns = (density.quantile(0.5), density.std(), low, high)
    return [_Summary(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def _estimate(
    log_e: _Summary, offset: float, nu: _Summary, field: SkinningField, warnings: tuple[str, ...]
) -> ClipEstimate:
    return ClipEstimate(
        youngs_modulus=10 ** (log_e.median + offset),
        poisson_ratio=nu.median,
        log10_youngs_modulus_std=log_e.std,
        poisson_ratio_std=nu.std,
        youngs_modulus_interval=(10 ** (log_e.low + offset), 10 ** (log_e.high + offset)),
        poisson_ratio_interval=(nu.low, nu.high),
        dimensionless_log10_stiffness=log_e.median,
        skinning_field=field,
        out_of_range=bool(warnings),
        warnings=warnings,
    )


def collate_clips(clips: Sequence[PreparedClip], intervals: Float64[np.ndarray, " B"], config: ClipConfig) -> ClipBatch:
    """Prepared clips as one batch; `intervals` are Δt √(g/L).

    Raises:
        InputError: a clip was prepared with another configuration.
    """
    shape = (config.frames, config.window, config.window, 4)
    for k, clip in enumerate(clips):
        if clip.windows.shape != shape:
            raise InputError(
                f"clips[{k}]: prepared as {clip.windows.shape}, this checkpoint reads {shape}; use its `prepare`"
            )
    return ClipBatch(
        windows=torch.from_numpy(np.stack([clip.windows for clip in clips])),
        moments=torch.from_numpy(np.stack([clip.moments for clip in clips]).astype(np.float32)),
        valid=torch.from_numpy(np.stack([clip.valid for clip in clips])),
        interval=torch.from_numpy(np.asarray(intervals, np.float32)),
        confidence=torch.tensor([clip.confidence for clip in clips], dtype=torch.float32),
    )
