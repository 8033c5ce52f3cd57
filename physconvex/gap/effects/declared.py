"""Effects that are declared and not simulated as such: numerical errors, gauges, and what only pixels' colours tell."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.gap.effects.effect import Dose, Effect, Motion

__all__ = ["DECLARED_EFFECTS", "GAUGES", "NUMERICAL"]


def _as_seen(motion: Motion, doses: Float[np.ndarray, " D"]) -> Float[np.ndarray, "T P 3"]:
    """Positions of points do not show it."""
    return motion.positions


# Their directions are differences of runs of the full-order model, see `physconvex.gap.numerics`.
_SHARE = Dose("share", "", -30.0, 30.0, 0.5, lambda s: 1.0, plausible=5.0)
NUMERICAL: tuple[Effect, ...] = (
    Effect(
        "time_step",
        "numerical",
        (Dose("share", "", 0.0, 60.0, 0.5, lambda s: 1.0),),
        description="error of implicit Euler with the model's time step, in multiples; acts as viscosity E Δt",
        confusable=("damping",),
    ),
    Effect(
        "mesh_resolution",
        "numerical",
        (_SHARE,),
        description="error of a coarser mesh, in multiples of the model's difference between two meshes",
    ),
    Effect(
        "reduction",
        "numerical",
        (_SHARE,),
        description="error of the reduced model, in multiples of its difference to the full-order one",
    ),
)
GAUGES: tuple[Effect, ...] = (
    Effect(
        "density",
        "gauge",
        (Dose("relative_error", "", -0.9, 10.0, 0.01, lambda s: 0.1),),
        description="E and density times the same factor leave the motion unchanged: E/density is what is told",
    ),
    Effect(
        "scale",
        "gauge",
        (Dose("relative_error", "", -0.9, 10.0, 0.01, lambda s: 0.1),),
        description="size, time and E change together; only gravity in free flight ties them",
    ),
)
_COLOUR_ONLY: tuple[Effect, ...] = tuple(
    Effect(
        name,
        "observation",
        (Dose(dose, unit, 0.0, 10.0, 0.01, lambda s: 0.1),),
        observe=_as_seen,
        applies=lambda s: False,
        description=text,
    )
    for name, dose, unit, text in (
        ("motion_blur", "exposure_time", "s", "edges widen along the motion; followed points do not show it"),
        ("exposure", "gain", "", "brightness of the picture; followed points do not show it"),
    )
)
DECLARED_EFFECTS: tuple[Effect, ...] = (*NUMERICAL, *_COLOUR_ONLY, *GAUGES)
