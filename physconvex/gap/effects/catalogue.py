"""The dictionary of effects that a diagnosis chooses from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from physconvex.errors import InputError
from physconvex.gap.effects.clamp import CLAMP_EFFECTS
from physconvex.gap.effects.declared import DECLARED_EFFECTS
from physconvex.gap.effects.effect import Effect, Situation
from physconvex.gap.effects.image import IMAGE_EFFECTS
from physconvex.gap.effects.load import LOAD_EFFECTS
from physconvex.gap.effects.material import MATERIAL_EFFECTS
from physconvex.gap.effects.observation import OBSERVATION_EFFECTS
from physconvex.gap.effects.world import WORLD_EFFECTS

__all__ = ["DEFAULT_EFFECTS", "EFFECT_NAMES", "applicable", "choose"]

DEFAULT_EFFECTS: tuple[Effect, ...] = (
    *MATERIAL_EFFECTS, *WORLD_EFFECTS, *LOAD_EFFECTS, *CLAMP_EFFECTS, *OBSERVATION_EFFECTS, *IMAGE_EFFECTS,
    *DECLARED_EFFECTS,
)  # fmt: skip
EFFECT_NAMES: tuple[str, ...] = tuple(dict.fromkeys(effect.name for effect in DEFAULT_EFFECTS))


def choose(
    names: Sequence[str] | None = None, *, without: Iterable[str] = (), extra: Iterable[Effect] = ()
) -> tuple[Effect, ...]:
    """The effects of these names (all unless given), but for some, and with some of one's own.

    Raises:
        InputError: a name that no effect has.
    """
    known = (*DEFAULT_EFFECTS, *extra)
    left_out = set(without)
    wanted = {effect.name for effect in known} if names is None else set(names)
    unknown = (wanted | left_out) - {effect.name for effect in known}
    if unknown:
        raise InputError(
            f"effects: got {sorted(unknown)}; expected names among {', '.join(sorted({e.name for e in known}))}"
        )
    return tuple(effect for effect in known if effect.name in wanted - left_out)


def applicable(effects: Iterable[Effect], situation: Situation) -> tuple[Effect, ...]:
    """Those that can be tried on the motion of points: never gauges, nor what shows in the pictures' light alone."""
    return tuple(
        effect
        for effect in effects
        if effect.source != "gauge" and effect.photograph is None and effect.applies(situation)
    )
