"""A floor that gives way: where markers sink into it, its stiffness and dashpot are base parameters.

`capture.json` states neither. Programs with a soft contact let a body sink in by percents of its size and take energy
from it there; a model with a hard floor can only answer with a body ten times too soft, after which everything looks
like damping. Contact and body are told apart by what markers do below the floor, and by the ringing after lift-off,
which a dashpot of the contact leaves alone and damping of the body does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.baseline import FLOOR_LAW, Baseline, run_base, steps_per_frame
from physconvex.gap.model import EffectModel, SecantModel
from physconvex.gap.options import GapOptions
from physconvex.identify import Fit, FitOptions, MarkerObservations, fit

__all__ = ["depth_seen", "with_giving_floor"]

_DEPTH = 0.01  # of the size of the body: markers lie deeper in a floor that gives way
_SOFTER = 1 / 3  # of the stiffness that a floor has in the base model
_FACTORS = (0.0, 0.25, 0.45, 0.6, 0.75)  # decades of E above the fit with the hard floor, which is too soft
_STIFFNESSES = (-0.7, -0.3, 0.1)  # decades about the stiffness that stops the body at the depth seen
_DASHPOTS = (0.0, 1.0, 3.0)  # in times that the body takes to sink in
_FITS, _ROUNDS = 3, 2
_BETTER = 0.5  # share of the squares that a giving floor may leave to be believed


def depth_seen(base: Baseline) -> float:
    """How deep markers lie in the floor in the fitted frames [m]: the second deepest, noise taken off.

    What frame 0 lies off its rest state by counts as a shift of the markers' frame.
    """
    seen, capture = base.observations, base.capture
    if not isinstance(seen, MarkerObservations) or capture.floor is None:
        return 0.0
    normal = np.asarray(capture.floor.normal) / np.linalg.norm(capture.floor.normal)
    frames = base.split.fitted

    first = (seen.positions[0] - seen.points) @ normal
    shift = float(np.nanmean(first)) if np.isfinite(first).any() else 0.0
    height = (seen.positions[frames] - np.asarray(capture.floor.point)) @ normal - shift + 4 * seen.sigma[frames]
    deep = np.sort(-height[np.isfinite(height)])
    return max(float(deep[-2]), 0.0) if len(deep) > 1 else 0.0


def with_giving_floor(base: Baseline, options: GapOptions, report: Callable[[str], None]) -> Baseline:
    """The rough base fit with stiffness and dashpot of the floor free, if the recording shows that it gives way.

    Unchanged where markers do not sink in, where the floor's give does not halve the squares, or where that asks for a
    floor about as stiff as the model's own.
    """
    if base.situation.clamped or not base.situation.touches or depth_seen(base) < _DEPTH * base.situation.size:
        return base
    report("fit of the floor's give")
    names = (*base.model.base, *FLOOR_LAW)
    count = int(base.split.fitted[-1]) + 1
    seen = base.observations.in_frames(count)
    before = float((seen.residuals(base.motion.positions[:count]) ** 2).sum())
    tried = []
    for values in _starts(base):
        model = _reduced(base, names, values, count)
        try:
            tried.append((float((seen.residuals(model.positions(values)) ** 2).sum()), values))
        except ConvergenceError:
            continue
    found: list[Fit] = []
    for _, values in sorted(tried, key=lambda pair: pair[0])[:_FITS]:
        try:
            found.append(_fitted(base, names, values, count, options))
        except ConvergenceError:
            continue
    best = min(found, key=lambda f: f.misfit, default=None)
    if best is None or 2 * best.misfit > _BETTER * before or _softness(base, names, best.values) > _SOFTER:
        return base
    twin = _reduced(base, names, best.values, count).twin
    return run_base(
        base.capture, base.observations, base.split, twin.with_values(names, best.values), best, cost=base.model.cost
    )


def _softness(base: Baseline, names: tuple[str, ...], values: np.ndarray) -> float:
    """Stiffness of the floor over that which the base model gives it for the same E."""
    own = base.model.twin.with_values(base.model.base, values[: len(base.model.base)]).scene.contact().stiffness
    return float(10 ** values[names.index(FLOOR_LAW[0])] / own)


def _starts(base: Baseline) -> list[np.ndarray]:
    """Values of the base parameters, the floor's last."""
    normal = np.asarray(base.capture.floor.normal) / np.linalg.norm(base.capture.floor.normal)  # type: ignore[union-attr]
    speed = max(-float((base.motion.velocities.mean(1) @ normal).min()), 1e-2)
    depth, names = depth_seen(base), base.model.base
    at, out = names.index("log10_youngs_modulus"), []
    for decades, shift, dashpot in product(_FACTORS, _STIFFNESSES, _DASHPOTS):
        values = base.fit.values.copy()
        values[at] += decades
        if "poisson_ratio" in names:
            values[names.index("poisson_ratio")] = np.clip(values[names.index("poisson_ratio")], 0.3, 0.45)
        pressure = np.sqrt(10 ** values[at] * base.capture.density) * speed  # of a body that stops within a wave's time
        out.append(np.append(values, [np.log10(pressure / depth) + shift, dashpot * depth / speed]))
    return out


def _reduced(base: Baseline, names: tuple[str, ...], values: np.ndarray, count: int) -> EffectModel:
    """The reduced base model of the first frames, with time steps that suit the values."""
    twin = base.model.twin
    steps = steps_per_frame(replace(twin, steps_per_frame=6), dict(zip(names, values, strict=True)))
    twin = replace(twin, steps_per_frame=steps)
    return replace(base.model, twin=twin, base=names, frames=count, reduced=True, mesh=None, correction=None)


def _fitted(base: Baseline, names: tuple[str, ...], values: np.ndarray, count: int, options: GapOptions) -> Fit:
    """A fit of the reduced model, its derivatives taken anew once.

    Raises:
        ConvergenceError: it cannot be simulated there.
    """
    seen, model = base.observations.in_frames(count), _reduced(base, names, values, count)
    stop = FitOptions(max_iterations=options.iterations + 3, relative_tolerance=1e-3, absolute_tolerance=0.05)
    for _ in range(_ROUNDS):
        motion = model.motion(values)
        secant = SecantModel(model, values, motion.positions, model.tangents(values, motion))
        found = fit(secant, seen, model.parameters(values), options=stop)
        values = found.values
    return found
