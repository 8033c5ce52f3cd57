"""Mass that hangs on a held body and that the base model does not know of."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.gap.effects.effect import AnyScene, Dose, Effect
from physconvex.gap.effects.scenes import with_material

__all__ = ["LOAD_EFFECTS"]

_END = 0.4  # of the half length: how far inward the load is spread


def _loaded(axis: int, side: int) -> Effect:
    def densities(x: Float[np.ndarray, "C 3"], masses: Float[np.ndarray, " C"], ratio: float) -> np.ndarray:
        along = side * x[:, axis]
        end = along >= along.max() - _END
        return np.where(end, 1 + ratio * masses.sum() / masses[end].sum(), 1.0)

    def scene(scene: AnyScene, doses: Float[np.ndarray, " D"]) -> AnyScene:
        if doses[0] <= 0:
            return scene
        return with_material(scene, density=lambda x, masses: densities(x, masses, float(doses[0])))

    return Effect(
        "attached_mass",
        "external",
        (Dose("mass_ratio", "", 0.0, 10.0, 0.02, lambda s: 0.3, plausible=2.0),),
        scene=scene,
        applies=lambda situation: situation.clamped,
        variant=f"{'-' if side < 0 else '+'}{'xyz'[axis]}",
        description="a load at one end of a held body, in units of its own mass: it sags further and swings slower",
        confusable=("time_scale",),
    )


LOAD_EFFECTS: tuple[Effect, ...] = tuple(_loaded(axis, side) for axis in range(3) for side in (-1, 1))
