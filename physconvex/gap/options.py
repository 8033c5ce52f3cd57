"""Settings of a diagnosis. The blind tests use the defaults."""

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
    """Settings of a diagnosis. The thresholds of its decisions are in `physconvex.gap.thresholds`."""

    max_nodes: Annotated[int, Field(ge=30)] = 250
    """Most nodes of the quadratic mesh of the model."""
    fine_nodes: HiddenCount = 1000
    """Nodes of the finer mesh; its difference to the mesh of the model is added to every run."""
    weights: HiddenCount = 8
    """Skinning weights of the reduced model in the first fit."""
    candidates: Count = 8
    """Sets of effects that are refitted with the full-order model. Half as many for a held body or a closed gap."""
    starts: Annotated[tuple[float, ...], CommandLine(hidden=True)] = (1.0, 0.5, 0.25)
    """Fractions of the screened doses from which a fit may start; the best one is used."""
    iterations: HiddenCount = 9
    """Linearisations of each fit."""
    most_effects: HiddenCount = 3
    """Largest number of effects in one set."""
    search_cost: HiddenSeconds = 240.0
    """Cost of model runs after which the search starts no further fit, in seconds of one core. It is computed from the
    number of runs, not measured, so the answer does not depend on the load of the machine."""
    decision_cost: HiddenSeconds = 900.0
    """The same for the full-order fits."""
    deadline: HiddenSeconds = 840.0
    """Wall-clock time [s] after which the diagnosis reports what it has, with a caveat. Only a slow or busy machine
    reaches it before the costs above."""
    error_scale: Hidden = 1.0
    """κ: factor of the numerical differences that are added to the noise."""
    discretisation: Hidden = 2e-3
    """Least numerical error of a model, relative to the displacement of the points."""
    detail: Hidden = 0.1
    """Share of the gap of a held body below which the remainder does not choose between effects."""
    significance: HiddenShare = 0.05
    """Probability of naming an effect where there is none, over the whole dictionary."""
    explained: HiddenShare = 0.5
    """Least reduction of the held-out gap by a named effect; below it the verdict is "unknown"."""
    confidence: HiddenShare = 0.9
    """Probability that an interval contains the true value."""
    bootstraps: HiddenCount = 400
    """Resamples of blocks of frames."""
    seed: Annotated[int, CommandLine(hidden=True)] = 0
    """Seed of the resamples."""
