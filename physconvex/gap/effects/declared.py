"""Effects that are declared and not simulated as such: numerical errors and gauges."""

from __future__ import annotations

from physconvex.gap.effects.effect import Dose, Effect

__all__ = ["DECLARED_EFFECTS", "GAUGES", "NUMERICAL"]


# Their directions are differences of runs of the full-order model, see `physconvex.gap.errors.numerics`.
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
DECLARED_EFFECTS: tuple[Effect, ...] = (*NUMERICAL, *GAUGES)
