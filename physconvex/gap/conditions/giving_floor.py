"""A floor that gives way: where markers sink into it, its stiffness and dashpot are base parameters.

`capture.json` states neither. Programs with a soft contact let a body sink in by percents of its size and take energy
from it there; a model with a hard floor can only answer with a body ten times too soft, after which everything looks
like damping. Contact and body are told apart by what markers do below the floor, and by the ringing after lift-off,
which a dashpot of the contact leaves alone and damping of the body does not.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from jaxtyping import Float

from physconvex.gap.base.baseline import FLOOR_LAW, Baseline
from physconvex.gap.conditions.joint_fits import Company
from physconvex.gap.thresholds import SETTING
from physconvex.identify import Fit

__all__ = ["on_giving_floor", "sinks_in", "softness"]


def sinks_in(base: Baseline) -> bool:
    """Whether markers lie deeper in the floor than a stiff one allows."""
    return base.situation.depth >= SETTING.soft_depth * base.situation.size


def on_giving_floor(company: Company, doses: Float[np.ndarray, " D"]) -> Fit | None:
    """The reduced model's fit with stiffness and dashpot of the floor free, from the best of a scan.

    None where no start can be simulated.

    Args:
        company: the rough base fit and the effects beside.
        doses: of these, where the scan is made.
    """
    base = company.base
    names = (*base.model.base, *FLOOR_LAW)
    starts = [np.append(values, doses) for values in _starts(base)]
    misfits = [company.misfit(names, values) for values in starts]
    order = [i for i in np.argsort(misfits)[: SETTING.fits] if np.isfinite(misfits[i])]
    return company.best(names, [starts[i] for i in order])


def softness(base: Baseline, names: tuple[str, ...], values: Float[np.ndarray, " K"]) -> float:
    """Stiffness of the floor over that which the base model gives it for the same E."""
    own = base.model.twin.with_values(base.model.base, values[: len(base.model.base)]).scene.contact().stiffness
    return float(10 ** values[names.index(FLOOR_LAW[0])] / own)


def _starts(base: Baseline) -> list[np.ndarray]:
    """Values of the base parameters, the floor's last."""
    normal = np.asarray(base.capture.floor.normal) / np.linalg.norm(base.capture.floor.normal)  # type: ignore[union-attr]
    speed = max(-float((base.motion.velocities.mean(1) @ normal).min()), 1e-2)
    depth, names = base.situation.depth, base.model.base
    at, out = names.index("log10_youngs_modulus"), []
    for decades, shift, dashpot in product(SETTING.moduli, SETTING.stiffnesses, SETTING.dashpots):
        values = base.fit.values.copy()
        values[at] += decades
        if "poisson_ratio" in names:
            values[names.index("poisson_ratio")] = np.clip(values[names.index("poisson_ratio")], *SETTING.poisson_ratio)
        pressure = np.sqrt(10 ** values[at] * base.capture.density) * speed  # of a body that stops within a wave's time
        out.append(np.append(values, [np.log10(pressure / depth) + shift, dashpot * depth / speed]))
    return out
