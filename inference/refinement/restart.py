"""Where a fit to colours loses the body after a contact, and where the search may begin again.

How a stiff body rebounds hangs on E, ν and damping together, and the points that are followed first do not tell one
rebound from another: what they are off by passes for rigid drift. The colours do, but from afar they lead nowhere.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from jaxtyping import Float

from inference.refinement.problem import Problem
from inference.refinement.reduced_search import material_of, started_from
from inference.refinement.rigid_drift import drifted
from physconvex.identify import ColourObservations, Fit

__all__ = ["colours_lost", "materials_about"]

_MODULI = (0.0, -0.08, 0.08)  # decades
_RATIOS = (0.25, 0.42)
_LOSSES = (0.1, 0.3)  # of energy, by the slowest wave's angular frequency times β; beside the damping that was found


def colours_lost(problem: Problem, found: Fit) -> float:
    """The colours' rms residual from the first contact on over that before it, where the model is all but exact.

    One where nothing is struck, or no colour is compared on both sides.
    """
    if problem.drift_limit is None:
        return 1.0
    stack, positions, begin = problem.observed.observations, drifted(problem, found), problem.drift_limit[0]
    before, after = [], []
    for part, where in zip(stack.parts, stack.point_slices, strict=True):
        if isinstance(part, ColourObservations):
            squares = np.square(part.residuals(positions[:, where]))
            before.append(squares[part.frames < begin])
            after.append(squares[part.frames >= begin])
    flight, rest = (np.concatenate(part) if part else np.zeros(0) for part in (before, after))
    if not len(flight) or not len(rest):
        return 1.0
    return float(np.sqrt(rest.mean() / max(flight.mean(), 1e-12)))


def materials_about(problem: Problem, found: Fit) -> list[Float[np.ndarray, " K"]]:
    """Values at which to look for another rebound, those of the fit first."""
    parameters = started_from(problem.parameters, found)
    modulus, density = material_of(problem.twin, found)
    slowest = np.pi * np.sqrt(10.0**modulus / density) / problem.twin.mesh.size  # half a wave along the body [rad/s]
    kept = {p.name: p.start for p in parameters}
    others = {
        "log10_youngs_modulus": [modulus + change for change in _MODULI],
        "poisson_ratio": _RATIOS,
        "damping_time": [kept.get("damping_time", 0.0), *(loss / slowest for loss in _LOSSES)],
    }
    choices = ([p.at(float(value)).start for value in others.get(p.name, [p.start])] for p in parameters)
    return [found.values, *map(np.array, product(*choices))]
