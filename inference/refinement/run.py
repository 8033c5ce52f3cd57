"""State shared by the steps of one refinement."""

from __future__ import annotations

from dataclasses import dataclass, field

from inference.refinement.options import RefineOptions
from inference.refinement.stages import Stages
from physconvex.identify import RollOuts
from physconvex.io import Capture, Workers


@dataclass(eq=False)
class RefinementRun:
    """A running refinement.

    Attributes:
        capture: the capture.
        options: the settings; the correction is off if the full model fails.
        stages: the finished stages.
        workers: processes for parallel work.
        warnings: notes for the user.
        memory: the last roll-outs of full models.
    """

    capture: Capture
    options: RefineOptions = field(default_factory=RefineOptions)
    stages: Stages = field(default_factory=Stages)
    workers: Workers = field(default_factory=Workers)
    warnings: list[str] = field(default_factory=list)
    memory: RollOuts = field(init=False)

    def __post_init__(self) -> None:
        self.memory = RollOuts(workers=self.workers)
