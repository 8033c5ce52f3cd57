"""What the user decides about an evaluation."""

from __future__ import annotations

from typing import Annotated

from pydantic import field_validator

from physconvex.io import CommandLine, Options


class PaperOptions(Options):
    """Sizes of the evaluation."""

    max_nodes: int = 500
    """Most nodes of the models' quadratic meshes."""
    fine_nodes: int | None = None
    """Most nodes of the mesh of refine's last searches; default: as it has them."""
    steps_per_frame: int | None = None
    """Of the models. Default: 384 per second."""
    weights: int = 20
    """Skinning weights of `refine`."""
    full_runs: int = 8
    """Most linearisations of the full model."""
    model_error: bool = True
    """Add what a finer mesh says."""
    adam_steps: int = 400
    """Of the published way; 0 leaves it out."""
    ablation: tuple[int, ...] = (8, 10, 12)
    """Weights M of the reduced model alone; repeatable."""
    ablation_points: Annotated[tuple[int, ...], CommandLine("--points")] = (4, 5, 6, 7, 8)
    """Points K per convex of further fields, of a quarter of the convexes, scored in the refined motion and in those of
    the ablation over M; repeatable; 0: none."""
    field_budget: int = 24_000
    """Most convexes of a field."""
    field_steps: int = 400
    """Steps of a field's fit."""
    checkpoint: str = "default"
    """Name or folder of the network's checkpoint."""

    @field_validator("ablation_points")
    @classmethod
    def _some(cls, counts: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(count for count in counts if count)
