"""How much of FEM motion the predicted handles follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from models import captured_energy, random_basis
from train.held_out import Evaluated, evaluated_clips, held_out_estimates
from train.options import EvaluationOptions
from train.progress import Report
from train.records import ClipSamples

BASES = ("predicted", "eigenmodes", "random")


@dataclass(frozen=True, eq=False)
class SkinningEvaluation:
    """Captured shares (0..1) per clip; columns: predicted, eigenmodes, random basis of as many handles."""

    of: Evaluated
    handles: int
    of_all: Float64[np.ndarray, "N 3"]
    """Of the whole displacement."""
    beyond_affine: Float64[np.ndarray, "N 3"]
    """Share of the remainder beyond the best affine motion of each frame."""

    def table(self) -> str:
        """For people."""
        lines = [f"{len(self.of_all)} clips ({self.of.split}), {self.handles} handles and the constant mode"]
        lines.append(f"{'':14}{'of all motion':>16}{'beyond affine':>16}{'its worst tenth':>18}")
        for k, name in enumerate(BASES):
            share = self.beyond_affine[:, k]
            lines.append(
                f"{name:14}{self.of_all[:, k].mean():16.4%}{share.mean():16.2%}{np.quantile(share, 0.1):18.2%}"
            )
        return "\n".join(lines)


def evaluate_skinning(
    data: Sequence[Path | str],
    options: EvaluationOptions,
    *,
    out: Path,
    report: Report | None = None,
) -> SkinningEvaluation:
    """Fit the FEM motion of every clip's sample points with three bases of as many handles."""
    evaluated, predictor, clips = evaluated_clips(data, options, out=out, report=report)
    handles, generator = predictor.config.network.skinning.handles, np.random.default_rng(options.seed)
    of_all, beyond = [], []
    progress = None if report is None else partial(report, "fitting motion")
    for label, estimate in zip(clips.labels, held_out_estimates(predictor, clips, report=progress), strict=True):
        samples = label.samples
        bases = (
            estimate.skinning_field(samples.points * label.object_size),
            samples.modes[:, :handles],
            random_basis(handles, generator=generator)(samples.points),
        )
        of_all.append([_share(samples, weights, "nothing") for weights in bases])
        beyond.append([_share(samples, weights, "affine") for weights in bases])
    return SkinningEvaluation(evaluated, handles, np.array(of_all), np.array(beyond))


def _share(samples: ClipSamples, weights: np.ndarray, after: Literal["nothing", "affine"]) -> float:
    return captured_energy(
        samples.displacements,
        rest=samples.points,
        volume_weights=samples.volume_weights,
        weights=weights,
        after=after,
    )


def write_skinning_report(out: Path, result: SkinningEvaluation) -> None:
    """`skinning.json` (with the command) and `skinning.png`."""
    from matplotlib.figure import Figure

    def by_basis(shares: np.ndarray) -> dict[str, float]:
        return dict(zip(BASES, shares.tolist(), strict=True))

    content = {
        "clips": len(result.of_all),
        "handles": result.handles,
        "captured_share_mean": by_basis(result.of_all.mean(axis=0)),
        "captured_share_beyond_affine_mean": by_basis(result.beyond_affine.mean(axis=0)),
        "captured_share_beyond_affine_median": by_basis(np.median(result.beyond_affine, axis=0)),
    }
    result.of.write(out / "skinning.json", content)
    figure = Figure(figsize=(6, 4), layout="constrained")
    axis = figure.subplots()
    rank = (np.arange(len(result.of_all)) + 0.5) / len(result.of_all)
    for k, name in enumerate(BASES):
        axis.plot(rank, np.sort(1 - result.beyond_affine[:, k]), label=f"{name}, {result.handles} handles")
    axis.set(xlabel="share of clips", ylabel="missed share of the motion beyond affine", yscale="log")
    axis.legend()
    figure.savefig(out / "skinning.png", dpi=130)
