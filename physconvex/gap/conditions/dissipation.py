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
from physconvex.identify import Fit, scan_values

__all__ = ["damped_fit"]

_RATIO, _RATIOS = "poisson_ratio", (0.3, 0.45)
# damping, in times that an elastic wave takes through the body: at every modulus, and about the best of these
_DAMPING, _OTHERS = 0.15, (0.05, 0.4)
_FITS = 2
_BETTER = 0.6  # share of the squares that damping may leave to be taken along


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
            values[names.index(_RATIO)] = np.clip(values[names.index(_RATIO)], *_RATIOS)
        return values

    tried = [(company.misfit(names, values), values) for values in (start(m, _DAMPING) for m in moduli)]
    best = int(np.argmin([misfit for misfit, _ in tried]))
    near = moduli[max(best - 1, 0) : best + 2]
    tried += [(company.misfit(names, values), values) for values in (start(*pair) for pair in product(near, _OTHERS))]
    order = [values for misfit, values in sorted(tried, key=lambda pair: pair[0])[:_FITS] if np.isfinite(misfit)]
    found = company.best(names, order)
    if found is None or found.misfit > _BETTER * company.misfit(names, np.append(base.fit.values, company.nothing)):
        return None
    return company, found
