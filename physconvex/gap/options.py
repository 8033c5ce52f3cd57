"""Settings of a diagnosis. The defaults are frozen: blind tests run with them."""

from __future__ import annotations

from dataclasses import dataclass

from physconvex.errors import InputError

__all__ = ["GapOptions"]


@dataclass(frozen=True)
class GapOptions:
    """How thoroughly a capture is diagnosed.

    Attributes:
        max_nodes: most nodes of the model's quadratic mesh.
        fine_nodes: nodes of the mesh whose difference to the model's is added to every run.
        weights: skinning weights of the reduced model of the rough fit.
        candidates: fits that the full-order model decides between, one of each set of effects; half as many of a held
            body, whose runs cost more, and whose cheaper model is a full-order one too, and where nothing is open.
        starts: shares of the screened doses that a fit may begin at; the one that fits best is taken.
        iterations: linearisations of each fit.
        most_effects: that are looked for together.
        search_cost: model runs after which the search begins no further fit, in seconds of one core; counted
            (`physconvex.gap.base.cost`), so that the answer does not depend on what else the machine does.
        decision_cost: the same of the full-order fits that decide.
        deadline: seconds by the clock in which a diagnosis ought to be through: what has been found by then is
            reported, with a caveat. Only where the machine is slow or busy does that come before the costs above.
        error_scale: κ, how much numerical differences widen the noise.
        discretisation: numerical error that any model of finite size is credited with, relative to the distance the
            points have moved; only where the differences of runs say less.
        detail: share of a held body's gap below which what is left does not choose between effects.
        significance: chance of calling an effect where there is none, over the whole dictionary.
        explained: least share of the held-out gap that a named effect must remove; below it the verdict is "unknown".
        confidence: of intervals.
        bootstraps: resamples of blocks of frames.
        seed: of the resamples.
    """

    max_nodes: int = 250
    fine_nodes: int = 1000
    weights: int = 8
    candidates: int = 8
    starts: tuple[float, ...] = (1.0, 0.5, 0.25)
    iterations: int = 9
    most_effects: int = 3
    search_cost: float = 240.0
    decision_cost: float = 900.0
    deadline: float = 840.0
    error_scale: float = 1.0
    discretisation: float = 2e-3
    detail: float = 0.1
    significance: float = 0.05
    explained: float = 0.5
    confidence: float = 0.9
    bootstraps: int = 400
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("max_nodes", "fine_nodes", "weights", "candidates", "iterations", "most_effects", "bootstraps"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}: got {getattr(self, name)}; expected at least 1")
        for name in ("search_cost", "decision_cost", "deadline"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name}: got {getattr(self, name)}; expected seconds, more than 0")
        for name in ("significance", "explained", "confidence"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(f"{name}: got {getattr(self, name)}; expected between 0 and 1")
