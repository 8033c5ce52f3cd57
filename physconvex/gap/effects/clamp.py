"""A clamp that gives way, which the base model holds to be rigid."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from physconvex.gap.effects.effect import AnyScene, Dose, Effect
from physconvex.gap.effects.scenes import scaled_coordinates, with_material
from physconvex.reduced import ReducedScene

__all__ = ["CLAMP_EFFECTS"]

_REACH = 0.15  # of the half size of the body: how far from the held points its give is spread


def _held(scene: AnyScene) -> np.ndarray:
    """Held points, scaled as the fields of `with_material` are."""
    assert scene.pins is not None
    held = scene.pins.points if isinstance(scene, ReducedScene) else scene.body.mesh.vertices[scene.pins.nodes]
    return scaled_coordinates(scene, held)


def _giving(scene: AnyScene, doses: Float[np.ndarray, " D"]) -> AnyScene:
    if doses[0] <= 0 or scene.pins is None:
        return scene
    held = cKDTree(_held(scene))

    def factor(x: Float[np.ndarray, "N 3"]) -> np.ndarray:
        distance = held.query(x)[0]
        reach = max(_REACH, 1.01 * float(distance.min()))
        return np.asarray(10 ** (-float(doses[0]) * np.clip(1 - distance / (2 * reach), 0.0, 1.0)))

    return with_material(scene, modulus=factor)


CLAMP_EFFECTS: tuple[Effect, ...] = (
    Effect(
        "clamp_compliance",
        "contact",
        (Dose("softening", "decades", 0.0, 2.0, 0.05, lambda s: 0.2, plausible=0.5),),
        scene=_giving,
        applies=lambda situation: situation.clamped,
        description="what holds the body gives way: E next to the held points is lower by so many decades",
        confusable=("heterogeneity",),
    ),
)
