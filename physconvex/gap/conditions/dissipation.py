"""A body that loses energy as it strikes: E and damping are looked for together, from a scan over both.

Without damping, a soft body that hardly bounces is best followed by one a hundred times as stiff: a fit of E alone ends
there, and from there no dose of damping looks right. Where the two together leave much less of the squares, numerical
errors are taken in their company, and the search for effects begins at them as well.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.model import MODULUS
from physconvex.gap.conditions.joint_fits import Company
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import SETTING
from physconvex.identify import Fit, scan_values

__all__ = ["damped_fit"]

_RATIO = "poisson_ratio"


def damped_fit(base: Baseline, options: GapOptions) -> tuple[Company, Fit] | None:
    """The reduced model's fit with damping, its dose the last value; None where it leaves nearly as much as without.

    Args:
        base: the rough base fit.
        options: settings.
    """
    company, names, capture = Company(base, options, ["damping"]), base.model.base, base.capture
    if MODULUS not in names or not company.effects:
        return None
    gravity = float(np.linalg.norm(capture.gravity))
    moduli = scan_values(density=capture.density, gravity=gravity, size=base.situation.size)

    def start(modulus: float, share: float) -> np.ndarray:
        wave = base.situation.size * np.sqrt(capture.density / 10**modulus)
        values = np.append(base.fit.values, share * wave)
        values[names.index(MODULUS)] = modulus
        if _RATIO in names:
            values[names.index(_RATIO)] = np.clip(values[names.index(_RATIO)], *SETTING.poisson_ratio)
        return values

    tried = [(company.misfit(names, values), values) for values in (start(m, SETTING.damping) for m in moduli)]
    best = int(np.argmin([misfit for misfit, _ in tried]))
    near = moduli[max(best - 1, 0) : best + 2]
    others = (start(*pair) for pair in product(near, SETTING.other_damping))
    tried += [(company.misfit(names, values), values) for values in others]
    first = sorted(tried, key=lambda pair: pair[0])[: SETTING.fits]
    order = [values for misfit, values in first if np.isfinite(misfit)]
    found = company.best(names, order)
    if found is None:
        return None
    without = company.misfit(names, np.append(base.fit.values, company.nothing))
    return None if found.misfit > SETTING.damped_better * without else (company, found)
