"""Effects of a held body: a compliant clamp, or a hanging load that the base model lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from physconvex.dynamics import HangingLoad
from physconvex.errors import InputError
from physconvex.fem import Scene
from physconvex.gap.effects.effect import AnyScene, Dose, Effect
from physconvex.gap.effects.scenes import cell_masses, scaled_coordinates, with_material
from physconvex.reduced import ReducedScene

_REACH = 0.15  # over half the size of the body: extent of the compliance around the held points


def _held(scene: AnyScene) -> np.ndarray:
    """Held points, scaled like the fields of `with_material`."""
    if isinstance(scene, ReducedScene):
        held = np.zeros((0, 3)) if scene.pins is None else scene.pins.points
    else:
        held = scene.body.mesh.vertices[[] if scene.held is None else scene.held.nodes]
    return scaled_coordinates(scene, held)


def _giving(scene: AnyScene, doses: Float[np.ndarray, " D"]) -> AnyScene:
    points = _held(scene)
    if doses[0] <= 0 or not len(points):
        return scene
    held = cKDTree(points)

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
_SPREAD = 0.05  # over the length: approximate width of a load further in
_STEEPEST = 150.0  # over the length: slope of a load at the very end, a decay to one twentieth within 2 %


def _shares(along: Float[np.ndarray, " N"], masses: Float[np.ndarray, " N"], inset: float) -> Float[np.ndarray, " N"]:
    """Density of the load along the body, from 0 at the loaded end to 1, with mean position `inset`.

    It is a bell about `inset`, weighted by the masses and tilted until its mean is right. The tilt corrects for the
    missing half of a bell at the very end, and for the discrete positions of nodes.
    """
    bell = np.log(masses) - 0.5 * ((along - inset) / _SPREAD) ** 2

    def tilted(slope: float) -> np.ndarray:
        logarithms = bell + slope * along
        weights = np.exp(logarithms - logarithms.max())
        return np.asarray(weights / weights.sum())

    def missed(slope: float) -> float:
        return float(tilted(slope) @ along) - inset

    for slope in (-_STEEPEST, _STEEPEST):  # the mean rises with the slope
        if missed(slope) * slope <= 0:
            return tilted(slope)
    return tilted(float(brentq(missed, -_STEEPEST, _STEEPEST)))


def _in_cells(scene: AnyScene, axis: int, side: int, ratio: float, inset: float) -> AnyScene:
    """The cells near the end are heavier."""

    def densities(x: Float[np.ndarray, "C 3"], masses: Float[np.ndarray, " C"]) -> np.ndarray:
        along = -0.5 * side * x[:, axis]
        return 1 + ratio * masses.sum() * _shares(along - along.min(), masses, inset) / masses

    return with_material(scene, density=densities)


def _on_nodes(scene: Scene, axis: int, side: int, *, ratio: float, inset: float, slack: float) -> Scene:
    """The nodes near the end carry it by a string of that slack; without slack it is fixed to them."""
    if scene.hanging is not None:
        raise InputError("hanging: a load hangs there already; one at a time")
    mesh, masses = scene.body.mesh, cell_masses(scene)
    along = side * mesh.vertices[:, axis]
    parts = np.repeat(masses / mesh.tets.shape[1], mesh.tets.shape[1])
    carried = np.bincount(mesh.tets.reshape(-1), parts, minlength=len(mesh.vertices))
    shares = _shares((along.max() - along) / np.ptp(along), carried, inset)
    return replace(scene, hanging=HangingLoad(mesh.vertices, ratio * masses.sum() * shares, slack))


_RATIO = Dose("mass_ratio", "", 0.0, 10.0, 0.02, lambda s: 0.3, plausible=2.0)
_INSET = Dose("inset", "", 0.0, 0.5, 0.01, lambda s: 0.02, shape=True, plausible=0.04)  # over the length
_SLACK = Dose("slack", "m", 0.0, 0.2, 1e-3, lambda s: 0.05 * s.size, shape=True)


def _loaded(axis: int, side: int, *, loose: bool = False) -> Effect:
    def scene(scene: AnyScene, doses: Float[np.ndarray, " D"]) -> AnyScene:
        ratio, inset, slack = float(doses[0]), max(float(doses[1]), 0.0), max(float(doses[2]), 0.0) if loose else 0.0
        if ratio <= 0:
            return scene
        if isinstance(scene, Scene) and (loose or scene.contact_points is None):
            return _on_nodes(scene, axis, side, ratio=ratio, inset=inset, slack=slack)
        return _in_cells(scene, axis, side, ratio, inset)  # fixed from the start

    end = f"{'-' if side < 0 else '+'}{'xyz'[axis]}"
    return Effect(
        "attached_mass",
        "external",
        (_RATIO, _INSET, _SLACK) if loose else (_RATIO, _INSET),
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
