"""From a source to the network's input, and from the estimate to a `Prediction`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from inference.loading import Conditions, LoadedClip, load_clip, resolve_conditions, retimed
from inference.pictures import frame_strip
from inference.prediction import Estimated, Prediction
from inference.settings import StatedConditions
from inference.sources import ClipSource, displayed_path
from models import ClipConfig, PreparedClip

if TYPE_CHECKING:
    from torch import nn

Prepare = Callable[..., PreparedClip]
"""Called as `prepare(frames, fps=, timestamps=, mask=, alpha=)`."""


@runtime_checkable
class Predictor(Protocol):
    """The interface of a predictor that inference uses (`models.estimator.PhysicsPredictor`)."""

    @property
    def network(self) -> nn.Module:
        """The torch module with the weights."""
        ...

    @property
    def config(self) -> object:
        """Everything besides the weights that affects an estimate; its `repr` distinguishes predictors."""
        ...

    @property
    def clip_config(self) -> ClipConfig:
        """Format of the network's input."""
        ...

    def prepare(self, frames: Any, **options: Any) -> PreparedClip:
        """Return the network's input for one clip."""
        ...

    def estimate(
        self, clips: Sequence[Any], *, density: Sequence[float], object_size: Sequence[float]
    ) -> Sequence[Estimated]:
        """Return one estimate per prepared clip."""
        ...


@dataclass(frozen=True)
class ReadyClip:
    """One clip as the network's input, with everything else that its prediction contains."""

    source: ClipSource | None
    prepared: PreparedClip
    conditions: Conditions
    warnings: tuple[str, ...]
    picture: bytes = b""
    """JPEG of the frames used, with the outline of the object; empty unless requested."""
    truncated: str = ""
    """Names a truncated file and states what is missing; else empty."""


def ready_clip(loaded: LoadedClip, settings: StatedConditions, prepare: Prepare, *, picture: bool = False) -> ReadyClip:
    """Prepare a loaded clip for the network."""
    conditions = resolve_conditions(loaded, settings)
    timed = retimed(loaded, conditions.fps)
    mask = None if timed.mask is None else timed.mask.astype("uint8") * 255
    prepared = prepare(timed.frames, fps=conditions.fps, timestamps=timed.timestamps, mask=mask, alpha=timed.alpha)
    strip = frame_strip(timed, prepared) if picture else b""
    return ReadyClip(None, prepared, conditions, loaded.warnings, strip, loaded.truncated)


def ready_source(
    source: ClipSource, settings: StatedConditions, prepare: Prepare, *, picture: bool = False
) -> ReadyClip:
    """Read a source and prepare it for the network.

    Raises:
        InputError: it cannot be read, or is too short to predict from.
    """
    return replace(ready_clip(load_clip(source), settings, prepare, picture=picture), source=source)


def to_prediction(ready: ReadyClip, estimate: Estimated) -> Prediction:
    """Combine a clip's estimate with the data it depends on."""
    prepared = ready.prepared
    warnings = dict.fromkeys((*ready.warnings, *prepared.warnings, *estimate.warnings))
    return Prediction(
        path=None if ready.source is None else displayed_path(ready.source.path),
        youngs_modulus=estimate.youngs_modulus,
        poisson_ratio=estimate.poisson_ratio,
        log10_youngs_modulus_std=estimate.log10_youngs_modulus_std,
        poisson_ratio_std=estimate.poisson_ratio_std,
        youngs_modulus_interval=estimate.youngs_modulus_interval,
        poisson_ratio_interval=estimate.poisson_ratio_interval,
        skinning_field=estimate.skinning_field,
        fps=ready.conditions.fps,
        density=ready.conditions.density,
        object_size=ready.conditions.object_size,
        assumed=ready.conditions.assumed,
        foreground=prepared.foreground,
        foreground_confidence=float(prepared.confidence),
        frames_used=int(prepared.valid.sum()),
        warnings=tuple(warnings),
        truncated=ready.truncated,
        silhouette=prepared.mask[0],
    )
