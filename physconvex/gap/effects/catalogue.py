"""The dictionary of effects for a diagnosis, with declared numerical errors and gauges."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from physconvex.errors import InputError
from physconvex.gap.effects.effect import Dose, Effect, Situation
from physconvex.gap.effects.held import CLAMP_EFFECTS, LOAD_EFFECTS
from physconvex.gap.effects.material import MATERIAL_EFFECTS
from physconvex.gap.effects.observation import IMAGE_EFFECTS, OBSERVATION_EFFECTS
from physconvex.gap.effects.world import WORLD_EFFECTS

# Their directions are differences of runs of the full-order model, see `physconvex.gap.errors.numerical_differences`.
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
DEFAULT_EFFECTS: tuple[Effect, ...] = (
    *MATERIAL_EFFECTS, *WORLD_EFFECTS, *LOAD_EFFECTS, *CLAMP_EFFECTS, *OBSERVATION_EFFECTS, *IMAGE_EFFECTS, *NUMERICAL,
    *GAUGES,
)  # fmt: skip
EFFECT_NAMES: tuple[str, ...] = tuple(dict.fromkeys(effect.name for effect in DEFAULT_EFFECTS))


def choose(
    names: Sequence[str] | None = None, *, without: Iterable[str] = (), extra: Iterable[Effect] = ()
) -> tuple[Effect, ...]:
    """The effects of these names (all by default), without the excluded ones, plus extra ones.

    Raises:
        InputError: no effect has that name, or none is left.
    """
    known = (*DEFAULT_EFFECTS, *extra)
    left_out = set(without)
    wanted = {effect.name for effect in known} if names is None else set(names)
    unknown = (wanted | left_out) - {effect.name for effect in known}
    if unknown:
        raise InputError(
            f"effects: got {sorted(unknown)}; expected names among {', '.join(sorted({e.name for e in known}))}"
        )
    chosen = tuple(effect for effect in known if effect.name in wanted - left_out)
    if not chosen:
        raise InputError("effects: none is left; expected at least one that `without` does not leave out")
    return chosen


def applicable(effects: Iterable[Effect], situation: Situation) -> tuple[Effect, ...]:
    """Effects that the motion of points can show: no gauges, and none that shows only in the light of pictures."""
    return tuple(
        effect
        for effect in effects
        if effect.source != "gauge" and effect.photograph is None and effect.applies(situation)
    )
