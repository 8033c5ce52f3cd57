"""Fits of the base model together with effects, started from scans over floor and damping.

Beside a tilt of gravity, a spin or friction, a compliant floor or a locking mesh is a small share of the squares.
Without these effects in the fit, floor and mesh take their place. The effects serve these tests alone: their doses are
discarded, and later steps decide which effects there are.

**Compliant floor.** `capture.json` states neither its stiffness nor its dashpot. In programs with a soft contact, a
body sinks in by percents of its size and loses energy there. A model with a rigid floor can only fit a body ten times
too soft, and then everything looks like damping. Two observations separate contact and body: the motion of markers
below the floor, and the vibration after lift-off, which only damping of the body changes.

**Strong damping.** Without damping, the best fit to a soft body that hardly bounces is one a hundred times as stiff. A
fit of E alone ends there, and no dose of damping helps from there. If E and damping together leave a much smaller
misfit, they define the point where numerical errors are estimated and where the search for effects also starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import FLOOR_LAW, Baseline
from physconvex.gap.base.model import MODULUS, RATIO, EffectModel
from physconvex.gap.base.observed_points import Seen
from physconvex.gap.base.rough_fit import steps_per_frame, with_rough_errors
from physconvex.gap.effects.catalogue import DEFAULT_EFFECTS, applicable
from physconvex.gap.effects.effect import Effect
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import SETTING
from physconvex.identify import Fit, FitOptions, fit, misfit_of, scan_values
from physconvex.mesh import TetMesh

RIGID = ("friction", "gravity_tilt", "air_drag (linear)", "initial_velocity", "initial_spin")


class JointFits:
    """A rough base fit and the effects that are fitted with it, by default those that move a body as a whole."""

    def __init__(self, base: Baseline, options: GapOptions, labels: Sequence[str] = RIGID) -> None:
        self.base = base
        known = {e.label: e for e in applicable(DEFAULT_EFFECTS, base.situation)}
        self.effects: tuple[Effect, ...] = tuple(known[label] for label in labels if label in known)
        self.frames = base.split.end
        self.seen: Seen = with_rough_errors(base.observations, base.twin, self.frames)
        self._iterations = options.iterations

    @property
    def nothing(self) -> Float[np.ndarray, " D"]:
        """Doses at which the added effects are absent."""
        return np.concatenate([np.zeros(0), *(effect.null for effect in self.effects)])

    def model(self, names: tuple[str, ...], values: np.ndarray) -> EffectModel:
        """The reduced model of the fitted frames, with time steps that suit the values; doses may follow these."""
        twin = self.base.model.twin
        steps = steps_per_frame(replace(twin, steps_per_frame=6), dict(zip(names, values, strict=False)))
        return replace(
            self.base.model, twin=replace(twin, steps_per_frame=steps), base=names, frames=self.frames, reduced=True,
            mesh=None, correction=None, effects=self.effects,
        )  # fmt: skip

    def misfit(self, names: tuple[str, ...], values: np.ndarray) -> float:
        """Misfit of the reduced model, by the observations' loss; infinite if it cannot be run."""
        try:
            return misfit_of(self.seen, self.model(names, values).positions(values))
        except ConvergenceError:
            return np.inf

    def best(self, names: tuple[str, ...], starts: Sequence[np.ndarray]) -> Fit | None:
        """The best fit of the reduced model from some starts, doses included; None if none can be simulated."""
        found: list[Fit] = []
        for values in starts:
            with suppress(ConvergenceError):
                found.append(self._fitted(names, values))
        return min(found, key=lambda f: f.misfit, default=None)

    def _fitted(self, names: tuple[str, ...], values: np.ndarray) -> Fit:
        model = self.model(names, values)
        stop = FitOptions(max_iterations=self._iterations + 3, relative_tolerance=1e-3, absolute_tolerance=0.05)
        for _ in range(SETTING.rounds):
            motion = model.motion(values)
            secant = model.secant(values, motion.positions, model.linearise(values, motion)[1])
            found = fit(secant, self.seen, model.parameters(values), options=stop)
            values = found.values
        return found

    def full(self, names: tuple[str, ...], reduced: Fit, mesh: TetMesh | None) -> Fit | None:
        """A short fit of the full-order model from one of the reduced model, with the derivatives of the latter.

        `mesh` has the elements (None for the twin's). None if the model cannot be run on it.
        """
        values = reduced.values
        cheap = self.model(names, values)
        full = replace(cheap, reduced=False, mesh=mesh)
        stop = FitOptions(max_iterations=SETTING.full_runs, relative_tolerance=1e-2, absolute_tolerance=0.05)
        try:
            tangents = cheap.linearise(values)[1]
            secant = full.secant(values, full.positions(values), tangents)
            return fit(secant, self.seen, full.parameters(values), options=stop)
        except (ConvergenceError, InputError):
            return None


def sinks_in(base: Baseline) -> bool:
    """Whether markers penetrate the floor deeper than a stiff one allows."""
    return base.situation.depth >= SETTING.soft_depth * base.situation.size


def on_giving_floor(joint: JointFits, doses: Float[np.ndarray, " D"]) -> Fit | None:
    """The reduced model's fit with free stiffness and dashpot of the floor, from a scan at some doses of the effects.

    None if no start works.
    """
    base = joint.base
    names = (*base.model.base, *FLOOR_LAW)
    starts = [np.append(values, doses) for values in _starts(base)]
    misfits = [joint.misfit(names, values) for values in starts]
    return joint.best(names, [starts[i] for i in np.argsort(misfits)[: SETTING.fits] if np.isfinite(misfits[i])])


def softness(base: Baseline, names: tuple[str, ...], values: Float[np.ndarray, " K"]) -> float:
    """Stiffness of the floor over that which the base model gives it for the same E."""
    own = base.model.twin.with_values(base.model.base, values[: len(base.model.base)]).scene.contact().stiffness
    return float(10 ** values[names.index(FLOOR_LAW[0])] / own)


def _starts(base: Baseline) -> list[np.ndarray]:
    """Values of the base parameters, the floor's last."""
    normal = np.asarray(base.capture.floor.normal) / np.linalg.norm(base.capture.floor.normal)  # type: ignore[union-attr]
    speed = max(-float((base.motion.velocities.mean(1) @ normal).min()), 1e-2)
    depth, at, out = base.situation.depth, base.model.base.index(MODULUS), []
    for decades, shift, dashpot in product(SETTING.moduli, SETTING.stiffnesses, SETTING.dashpots):
        values = _with_modulus(base, base.fit.values[at] + decades)
        pressure = np.sqrt(10 ** values[at] * base.capture.density) * speed  # stop within a wave transit time
        out.append(np.append(values, [np.log10(pressure / depth) + shift, dashpot * depth / speed]))
    return out


def _with_modulus(base: Baseline, modulus: float) -> np.ndarray:
    """The values of a base fit with another log10 E, and with ν away from its limits."""
    values, names = base.fit.values.copy(), base.model.base
    values[names.index(MODULUS)] = modulus
    if RATIO in names:
        at = names.index(RATIO)
        values[at] = np.clip(values[at], *SETTING.poisson_ratio)
    return values


def damped_fit(base: Baseline, options: GapOptions) -> tuple[JointFits, Fit] | None:
    """The reduced model's fit with damping, its dose the last value; None if it hardly improves the fit."""
    joint, names, capture = JointFits(base, options, ["damping"]), base.model.base, base.capture
    if MODULUS not in names or not joint.effects:
        return None
    gravity = float(np.linalg.norm(capture.gravity))
    moduli = scan_values(density=capture.density, gravity=gravity, size=base.situation.size)

    def at(modulus: float, share: float) -> tuple[float, np.ndarray]:
        wave = base.situation.size * np.sqrt(capture.density / 10**modulus)
        values = np.append(_with_modulus(base, modulus), share * wave)
        return joint.misfit(names, values), values

    tried = [at(modulus, SETTING.damping) for modulus in moduli]
    best = int(np.argmin([misfit for misfit, _ in tried]))
    tried += [at(*pair) for pair in product(moduli[max(best - 1, 0) : best + 2], SETTING.other_damping)]
    first = sorted(tried, key=lambda pair: pair[0])[: SETTING.fits]
    found = joint.best(names, [values for misfit, values in first if np.isfinite(misfit)])
    if found is None:
        return None
    without = joint.misfit(names, np.append(base.fit.values, joint.nothing))
    return None if found.misfit > SETTING.damped_better * without else (joint, found)
