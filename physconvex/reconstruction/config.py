"""Configuration of a reconstruction, readable from YAML."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from physconvex.io import FrozenConfig, read_tree, set_value, validated

StartKind = Literal["auto", "mesh", "hull", "points"]
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_EXAMPLE = "budget=12000"


class ReconstructionConfig(FrozenConfig):
    """Settings of a reconstruction. Lengths are in footprints, the size of one pixel of the full image at the object.

    Attributes:
        start: source of the first convexes: the mesh of the capture, the visual hull of the masks, or points. `auto`
            takes the mesh if there is one, else points if given, else the hull.
        budget: most convexes.
        points_per_convex: K, 3 to 9; three make flat convexes; below six, gaps are not filled after the fit.
        start_share: share of the budget that covers the surface at the start; refinement adds the rest.
        filler_share: share of the budget that may fill the inside.
        gap_share: share of the budget that is reserved to fill gaps after the fit; the other shares refer to the rest.
        steps: steps of the optimiser, one view each.
        levels, level_shares: scales of the image from coarse to fine, and the share of the steps at each.
        refinements: how often convexes are split, cloned and pruned, evenly over the first `refine_until` of the steps.
        dissimilarity: λ of (1 − λ) L1 + λ (1 − SSIM)/2.
        mask_weight: weight of the mean difference of alpha and mask.
        edge_width: initial width of the soft edges.
        point_rate: largest step of a coordinate; all rates fall to `final_rate` times their value.
        edge_rate: step of log α and log β; opacity_rate: of the logit; colour_rate: of the first harmonic. The other
            harmonics get `view_rate` times this, and decay by `view_decay` per step.
        seed: of the order of the views and of all samples.
    """

    start: StartKind = "auto"
    budget: int = Field(default=16_000, ge=50)
    points_per_convex: int = Field(default=6, ge=3, le=9)
    start_share: Share = 0.8
    filler_share: Share = 0.1
    gap_share: Share = 0.1
    steps: int = Field(default=200, ge=1)
    levels: tuple[Share, ...] = (0.25, 0.5, 1.0)
    level_shares: tuple[Share, ...] = (0.1, 0.2, 0.7)
    refinements: int = Field(default=5, ge=0)
    refine_until: Share = 0.6
    dissimilarity: Share = 0.2
    mask_weight: float = Field(default=0.2, ge=0, allow_inf_nan=False)
    edge_width: Positive = 0.7
    point_rate: Positive = 0.3
    edge_rate: Positive = 0.06
    opacity_rate: Positive = 0.1
    colour_rate: Positive = 0.05
    view_rate: float = Field(default=0.05, ge=0, allow_inf_nan=False)
    view_decay: Share = 0.002
    final_rate: Share = 0.1
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def check(self) -> ReconstructionConfig:
        if len(self.levels) != len(self.level_shares) or not self.levels or min(self.levels) <= 0:
            raise ValueError(f"levels {self.levels} and level_shares {self.level_shares} must be as many, above zero")
        if abs(sum(self.level_shares) - 1) > 1e-6:
            raise ValueError(f"level_shares {self.level_shares} must sum to one")
        return self

    @property
    def fit_budget(self) -> int:
        """Most convexes during the fit."""
        return self.budget - round(self.gap_share * self.budget)

    def scale_at(self, step: int) -> float:
        """Scale of the image in a step."""
        passed = 0.0
        for scale, share in zip(self.levels, self.level_shares, strict=True):
            passed += share * self.steps
            if step < passed - 1e-9:
                return scale
        return self.levels[-1]

    def refinement_steps(self) -> tuple[int, ...]:
        """Steps before which the convexes are refined."""
        every = self.refine_until * self.steps / max(self.refinements, 1)
        return tuple(sorted({round(every * (k + 1)) for k in range(self.refinements)} - {0}))


def load_reconstruction_config(
    source: str | Path | ReconstructionConfig | None = None, *, overrides: Sequence[str] = (), **values: Any
) -> ReconstructionConfig:
    """A configuration, that of a YAML file or the defaults, with `name=value` overrides, and values that are not None.

    Raises:
        InputError: no such file, bad YAML, an unknown name or a value out of range.
    """
    tree: dict[str, Any] = {}
    if isinstance(source, ReconstructionConfig):
        tree = source.model_dump()
    elif source is not None:
        tree = read_tree(source, None, argument="config", expected="lines such as `budget: 12000`")
    for override in overrides:
        set_value(tree, override, example=_EXAMPLE)
    tree.update({name: value for name, value in values.items() if value is not None})
    return validated(ReconstructionConfig, tree, argument="configuration")
