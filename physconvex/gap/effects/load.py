"""Mass that hangs on a held body and that the base model does not know of."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.fem import HangingLoad, Scene
from physconvex.gap.effects.effect import AnyScene, Dose, Effect
from physconvex.gap.effects.scenes import cell_coordinates, cell_masses, with_fields, with_material

__all__ = ["LOAD_EFFECTS"]

_END = 0.4  # of the half length: how far inward the load is spread


def _end(x: Float[np.ndarray, "C 3"], axis: int, side: int) -> np.ndarray:
    """Which cells carry the load."""
    along = side * x[:, axis]
    return np.asarray(along >= along.max() - _END)


def _fixed(scene: AnyScene, axis: int, side: int, ratio: float) -> AnyScene:
    """The load moves with the body from the start."""

    def densities(x: Float[np.ndarray, "C 3"], masses: Float[np.ndarray, " C"]) -> np.ndarray:
        end = _end(x, axis, side)
        return np.where(end, 1 + ratio * masses.sum() / masses[end].sum(), 1.0)

    return with_material(scene, density=densities)


def _loose(scene: Scene, axis: int, side: int, ratio: float, slack: float) -> AnyScene:
    """The load hangs on a slack string."""
    if scene.hanging is not None:
        raise InputError("hanging: a load hangs there already; one at a time")
    mesh, masses = scene.body.mesh, cell_masses(scene)
    end = _end(cell_coordinates(scene), axis, side)
    share = np.where(end, ratio * masses.sum() * masses / masses[end].sum(), 0.0) / mesh.tets.shape[1]
    nodes = np.bincount(mesh.tets.reshape(-1), np.repeat(share, mesh.tets.shape[1]), minlength=len(mesh.vertices))
    return with_fields(scene, hanging=HangingLoad(nodes, slack))


_RATIO = Dose("mass_ratio", "", 0.0, 10.0, 0.02, lambda s: 0.3, plausible=2.0)
_SLACK = Dose("slack", "m", 0.0, 0.2, 1e-3, lambda s: 0.05 * s.size, shape=True)


def _loaded(axis: int, side: int, *, loose: bool = False) -> Effect:
    def scene(scene: AnyScene, doses: Float[np.ndarray, " D"]) -> AnyScene:
        if doses[0] <= 0:
            return scene
        if loose and isinstance(scene, Scene):  # the reduced model has it fixed from the start
            return _loose(scene, axis, side, float(doses[0]), max(float(doses[1]), 0.0))
        return _fixed(scene, axis, side, float(doses[0]))

    end = f"{'-' if side < 0 else '+'}{'xyz'[axis]}"
    return Effect(
        "attached_mass",
        "external",
        (_RATIO, _SLACK) if loose else (_RATIO,),
        scene=scene,
        applies=lambda situation: situation.clamped and (not loose or any(situation.gravity)),
        variant=f"{end}, loose" if loose else end,
        description=(
            "a load that hangs on one end by a slack string: it falls by itself first, then tears the body down"
            if loose
            else "a load at one end of a held body, in units of its own mass: it sags further and swings slower"
        ),
        confusable=("time_scale",),
    )


LOAD_EFFECTS: tuple[Effect, ...] = tuple(
    _loaded(axis, side, loose=loose) for loose in (False, True) for axis in range(3) for side in (-1, 1)
)
