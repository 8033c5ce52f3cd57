"""Settings of a diagnosis. The defaults are frozen: blind tests run with them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from physconvex.io import CommandLine, Options

Count = Annotated[int, Field(ge=1)]
HiddenCount = Annotated[int, Field(ge=1), CommandLine(hidden=True)]
HiddenSeconds = Annotated[float, Field(gt=0), CommandLine(hidden=True)]
HiddenShare = Annotated[float, Field(gt=0, lt=1), CommandLine(hidden=True)]
Hidden = Annotated[float, CommandLine(hidden=True)]


class GapOptions(Options):
    """How thoroughly a capture is diagnosed. `physconvex.gap.thresholds` has what the diagnosis decides by."""

    max_nodes: Annotated[int, Field(ge=30)] = 250
    """Most nodes of the model's quadratic mesh."""
    fine_nodes: HiddenCount = 1000
    """Nodes of the mesh whose difference to the model's is added to every run."""
    weights: HiddenCount = 8
    """Skinning weights of the reduced model of the rough fit."""
    candidates: Count = 8
    """Sets of effects that the full-order model decides between. It decides between half as many for a held body,
    whose runs cost more, and where no gap is open."""
    starts: Annotated[tuple[float, ...], CommandLine(hidden=True)] = (1.0, 0.5, 0.25)
    """Shares of the screened doses at which a fit may begin; the best one is taken."""
    iterations: HiddenCount = 9
    """Linearisations of each fit."""
    most_effects: HiddenCount = 3
    """Most effects that are looked for together."""
    search_cost: HiddenSeconds = 240.0
    """Model runs after which the search begins no further fit, in seconds of one core. They are counted, not timed, so
    that the answer does not depend on what else the machine does."""
    decision_cost: HiddenSeconds = 900.0
    """The same of the full-order fits that decide."""
    deadline: HiddenSeconds = 840.0
    """Seconds by the clock after which the diagnosis reports what has been found, with a caveat. Only on a slow or busy
    machine does it come before the costs above."""
    error_scale: Hidden = 1.0
    """κ: how much numerical differences widen the noise."""
    discretisation: Hidden = 2e-3
    """Numerical error of any model of finite size, relative to the distance the points have moved. It counts where
    the differences of runs say less."""
    detail: Hidden = 0.1
    """Share of a held body's gap below which what is left does not choose between effects."""
    significance: HiddenShare = 0.05
    """Chance of calling an effect where there is none, over the whole dictionary."""
    explained: HiddenShare = 0.5
    """Least share of the held-out gap that a named effect removes; below it the verdict is "unknown"."""
    confidence: HiddenShare = 0.9
    """Probability that intervals hold the true value."""
    bootstraps: HiddenCount = 400
    """Resamples of blocks of frames."""
    seed: Annotated[int, CommandLine(hidden=True)] = 0
    """Seed of the resamples."""
