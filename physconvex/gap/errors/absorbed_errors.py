"""What E and ν cannot absorb of the error of a mesh, found by fitting them: of a held body.

A coarser mesh is stiffer, so that a held body vibrates faster on it and soon is out of step with a finer one. E makes
up for that, in a recording's fit as well, so that the error which is left is much smaller than the difference of the
two meshes; and by a change of E that is too large for derivatives once the phases have parted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.model import MODULUS, SecantModel
from physconvex.gap.errors.numerics import Numerics
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import NUMERICAL_ERROR
from physconvex.identify import FitOptions, MarkerObservations, fit

__all__ = ["with_absorbed_mesh"]


def with_absorbed_mesh(base: Baseline, numerics: Numerics, options: GapOptions) -> Numerics:
    """The differences with that of the meshes taken between their fits; unchanged for a free body.

    Args:
        base: the base fit, on the finer mesh.
        numerics: differences at one set of values.
        options: settings.
    """
    if not base.situation.clamped or numerics.fine is None or MODULUS not in base.model.base:
        return numerics
    count = base.split.end
    coarse, target = replace(base.model, mesh=None, correction=None), base.motion.positions
    shorter, values = replace(coarse, frames=count), base.fit.values
    sigma = np.full(target.shape[:2], NUMERICAL_ERROR.absorbed * base.situation.size)
    seen = MarkerObservations(np.asarray(base.model.points), target, sigma).in_frames(count)
    try:
        here = shorter.motion(values)
        secant = SecantModel(shorter, values, here.positions, shorter.tangents(values, here))
        stop = FitOptions(max_iterations=options.iterations, relative_tolerance=1e-2, absolute_tolerance=0.1)
        found = fit(secant, seen, shorter.parameters(values), options=stop)
        left = coarse.motion(found.values).positions - target
    except ConvergenceError:
        return numerics
    if np.linalg.norm(left) > np.linalg.norm(numerics.mesh):
        return numerics
    return replace(numerics, absorbed_mesh=left)
