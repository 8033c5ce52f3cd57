"""Fits of the base model in the company of effects: what the recording's floor and elements are is asked with them.

Beside a tilt of gravity, a spin or friction, a floor's give is a small share of the squares, and so is what a mesh that
locks does; without them, both stand in for the effect. The company serves these questions alone: its doses are thrown
away, and which effects there are is asked later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.base_fit import steps_per_frame
from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.model import EffectModel, SecantModel
from physconvex.gap.base.observed_points import Seen
from physconvex.gap.base.rough_errors import with_rough_errors
from physconvex.gap.effects.catalogue import DEFAULT_EFFECTS, applicable
from physconvex.gap.effects.effect import Effect
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import SETTING
from physconvex.identify import Fit, FitOptions, fit, misfit_of
from physconvex.mesh import TetMesh

__all__ = ["RIGID", "Company"]

RIGID = ("friction", "gravity_tilt", "air_drag (linear)", "initial_velocity", "initial_spin")


class Company:
    """A rough base fit, and the effects that are fitted beside.

    Args:
        base: the rough base fit.
        options: settings.
        labels: of the effects; those that move a body as a whole unless given.
    """

    def __init__(self, base: Baseline, options: GapOptions, labels: Sequence[str] = RIGID) -> None:
        self.base = base
        known = {e.label: e for e in applicable(DEFAULT_EFFECTS, base.situation)}
        self.effects: tuple[Effect, ...] = tuple(known[label] for label in labels if label in known)
        self.frames = base.split.end
        self.seen: Seen = with_rough_errors(base.observations, base.twin, self.frames)
        self._iterations = options.iterations

    @property
    def nothing(self) -> Float[np.ndarray, " D"]:
        """Doses at which the company is absent."""
        return np.concatenate([np.zeros(0), *(effect.null for effect in self.effects)])

    def model(self, names: tuple[str, ...], values: np.ndarray) -> EffectModel:
        """The reduced model of the fitted frames, with time steps that suit the values.

        Args:
            names: of the base parameters.
            values: theirs, more may follow.
        """
        twin = self.base.model.twin
        steps = steps_per_frame(replace(twin, steps_per_frame=6), dict(zip(names, values, strict=False)))
        return replace(
            self.base.model, twin=replace(twin, steps_per_frame=steps), base=names, frames=self.frames, reduced=True,
            mesh=None, correction=None, effects=self.effects,
        )  # fmt: skip

    def misfit(self, names: tuple[str, ...], values: np.ndarray) -> float:
        """What the reduced model leaves, by the observations' loss; infinite where it cannot be run."""
        try:
            return misfit_of(self.seen, self.model(names, values).positions(values))
        except ConvergenceError:
            return np.inf

    def best(self, names: tuple[str, ...], starts: Sequence[np.ndarray]) -> Fit | None:
        """The best fit of the reduced model from some starts, doses included; None where none can be simulated."""
        found: list[Fit] = []
        for values in starts:
            try:
                found.append(self._fitted(names, values))
            except ConvergenceError:
                continue
        return min(found, key=lambda f: f.misfit, default=None)

    def _fitted(self, names: tuple[str, ...], values: np.ndarray) -> Fit:
        model = self.model(names, values)
        stop = FitOptions(max_iterations=self._iterations + 3, relative_tolerance=1e-3, absolute_tolerance=0.05)
        for _ in range(SETTING.rounds):
            motion = model.motion(values)
            secant = SecantModel(model, values, motion.positions, model.tangents(values, motion))
            found = fit(secant, self.seen, model.parameters(values), options=stop)
            values = found.values
        return found

    def full(self, names: tuple[str, ...], reduced: Fit, mesh: TetMesh | None) -> Fit | None:
        """A short fit of the full-order model from one of the reduced model, by the derivatives of that.

        Args:
            names: of the base parameters.
            reduced: where to begin.
            mesh: the elements; None for the twin's.

        Returns:
            None where the model cannot be run on that mesh.
        """
        values = reduced.values
        cheap = self.model(names, values)
        full = replace(cheap, reduced=False, mesh=mesh)
        stop = FitOptions(max_iterations=SETTING.full_runs, relative_tolerance=1e-2, absolute_tolerance=0.05)
        try:
            tangents = cheap.tangents(values, cheap.motion(values))
            secant = SecantModel(full, values, full.positions(values), tangents)
            return fit(secant, self.seen, full.parameters(values), options=stop)
        except (ConvergenceError, InputError):
            return None
