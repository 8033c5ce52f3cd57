"""Effects of the material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float

from physconvex.gap.effects.effect import AnyScene, Dose, Effect, Situation
from physconvex.gap.effects.scenes import with_material
from physconvex.materials import (
    Law,
    Plasticine,
    StandardLinearSolid,
    combined,
    get_law,
    with_fibres,
    with_strain_stiffening,
)

Doses = Float[np.ndarray, " D"]
Axis = tuple[int, int, int]
_INCLUSION = 0.5  # width (standard deviation) of a softer or stiffer part, over half the edges of the body
_UNYIELDING = 9.0  # log10 of a yield stress [Pa] that no motion here reaches


DAMPING = Effect(
    "damping",
    "material",
    (Dose("damping_time", "s", 0.0, 0.2, 1e-4, lambda s: 0.05 * s.wave_time),),
    scene=lambda scene, doses: replace(scene, damping_time=scene.damping_time + float(doses[0])),
    description="viscosity in proportion to stiffness (Kelvin–Voigt): every strain rate costs energy",
    confusable=("viscoelasticity", "time_step", "restitution"),
)


def _relaxing(scene: AnyScene, doses: Doses) -> AnyScene:
    if doses[0] <= 0:
        return scene
    return with_material(scene, flow=StandardLinearSolid(float(doses[0]), float(10 ** doses[1])))


def _viscoelasticity(variant: str, periods: float) -> Effect:
    return Effect(
        "viscoelasticity",
        "material",
        (
            Dose("modulus_ratio", "", 0.0, 5.0, 0.05, lambda s: 0.3),
            Dose("log10_relaxation_time", "log10 s", -5.0, 2.0, 0.1, lambda s: float(np.log10(periods * s.wave_time)),
                 shape=True),
        ),
        scene=_relaxing,
        variant=variant,
        description="standard linear solid: stiffer in fast motion than in slow, with a relaxation time",
        confusable=("damping",),
    )  # fmt: skip


def _yielding(scene: AnyScene, doses: Doses) -> AnyScene:
    if doses[0] >= _UNYIELDING - 0.5:
        return scene
    ground = scene.body.law.ground or scene.body.law
    elastic = ground.name if ground.volumetric is not None else "hencky"
    return with_material(scene, flow=Plasticine(float(10 ** doses[0]), elastic))


def _yield_trial(situation: Situation, share: float = 0.4) -> float:
    return float(np.log10(share * max(situation.peak_stress, 1e-3 * situation.youngs_modulus))) - _UNYIELDING


PLASTICITY = Effect(
    "plasticity",
    "material",
    (Dose("log10_yield_stress", "log10 Pa", 0.0, _UNYIELDING, 0.1, _yield_trial, null=_UNYIELDING, threshold=True),),
    scene=_yielding,
    description="strain beyond a yield stress stays",
    confusable=("viscoelasticity",),
)


def _uneven(scene: AnyScene, doses: Doses) -> AnyScene:
    def factor(x: np.ndarray) -> np.ndarray:
        core = 1 - np.minimum((x**2).sum(1), 2.0)
        return np.asarray(10 ** (x @ doses[:3] + core * doses[3]))

    return with_material(scene, modulus=factor)


HETEROGENEITY = Effect(
    "heterogeneity",
    "material",
    tuple(
        Dose(f"log10_modulus_{where}", "decades", -1.0, 1.0, 0.05, lambda s: 0.1, plausible=0.3)
        for where in ("along_x", "along_y", "along_z", "in_the_core")
    ),
    scene=_uneven,
    description="E varies over the body: along an axis, or between core and rim",
    confusable=("anisotropy",),
)


def _halfway(side: int) -> Callable[[Situation], float]:
    return lambda situation: 0.5 * side


def _inclusion(corner: tuple[int, int, int]) -> Effect:
    """An inclusion whose fit starts near one corner of the body."""

    def scene(scene: AnyScene, doses: Doses) -> AnyScene:
        if doses[0] == 0:
            return scene

        def factor(x: np.ndarray) -> np.ndarray:
            return np.asarray(10 ** (doses[0] * np.exp(-0.5 * ((x - doses[1:]) ** 2).sum(1) / _INCLUSION**2)))

        return with_material(scene, modulus=factor)

    return Effect(
        "heterogeneity",
        "material",
        (
            Dose("log10_modulus", "decades", -3.0, 3.0, 0.05, lambda s: -0.2, plausible=0.5),
            *(
                Dose(f"centre_{axis}", "", -1.0, 1.0, 0.1, _halfway(side), shape=True)
                for axis, side in zip("xyz", corner, strict=True)
            ),
        ),
        scene=scene,
        variant="inclusion, " + "".join("-+"[side > 0] + axis for axis, side in zip("xyz", corner, strict=True)),
        description="a part of the body is softer or stiffer than the rest (centre over half of the edges)",
        confusable=("anisotropy",),
    )


def _with_fibres(variant: str, axes: tuple[Axis, Axis, Axis]) -> Effect:
    """Fibres whose fit starts at a direction, with angles towards two others across it."""
    along, first, second = (np.array(axis) / np.linalg.norm(axis) for axis in axes)

    def scene(scene: AnyScene, doses: Doses) -> AnyScene:
        if doses[0] <= 0:
            return scene
        direction = along + np.tan(doses[1]) * first + np.tan(doses[2]) * second
        return with_material(scene, law=lambda law: with_fibres(law, direction, float(doses[0])))

    return Effect(
        "anisotropy",
        "material",
        (
            Dose("modulus_ratio", "", 0.0, 20.0, 0.1, lambda s: 0.5),
            Dose("angle_1", "rad", -0.9, 0.9, 0.1, lambda s: 0.0, shape=True),
            Dose("angle_2", "rad", -0.9, 0.9, 0.1, lambda s: 0.0, shape=True),
        ),
        scene=scene,
        variant=variant,
        description="fibres stiffen one direction",
        confusable=("heterogeneity", "nonlinear_elasticity"),
    )


# three axes of the body and its four diagonals: every direction is within 28 degrees of one of them, and fibres along a
# diagonal differ from fibres along any axis
_FIBRES: dict[str, tuple[Axis, Axis, Axis]] = {
    "x": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "y": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "z": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "+x+y+z": ((1, 1, 1), (1, -1, 0), (1, 1, -2)),
    "-x+y+z": ((-1, 1, 1), (-1, -1, 0), (-1, 1, -2)),
    "+x-y+z": ((1, -1, 1), (1, 1, 0), (1, -1, -2)),
    "+x+y-z": ((1, 1, -1), (1, -1, 0), (1, 1, 2)),
}


def _stiffening(scene: AnyScene, doses: Doses) -> AnyScene:
    if doses[0] <= 0:
        return scene
    return with_material(scene, law=lambda law: with_strain_stiffening(law, float(doses[0])))


def mixed_law(law: Law, other: Law, share: float) -> Law:
    """(1 − share) of one law and a share of another."""
    return combined(f"{law.name}~{other.name}", (1 - share, law), (share, other))


def _towards(name: str) -> Callable[[AnyScene, Doses], AnyScene]:
    def scene(scene: AnyScene, doses: Doses) -> AnyScene:
        return with_material(scene, law=lambda law: mixed_law(law, get_law(name), float(doses[0])))

    return scene


def _nonlinear(variant: str, dose: Dose, scene: Callable[[AnyScene, Doses], AnyScene], description: str) -> Effect:
    return Effect(
        "nonlinear_elasticity", "material", (dose,), scene=scene, variant=variant, description=description,
        confusable=("anisotropy", "contact_stiffness"),
    )  # fmt: skip


NONLINEAR = (
    _nonlinear(
        "stiffening",
        Dose("stiffening_rate", "", 0.0, 50.0, 0.1, lambda s: 0.5),
        _stiffening,
        "shear stiffness grows with strain (Yeoh's second term)",
    ),
    _nonlinear(
        "law",
        Dose("corotated_share", "", -0.5, 1.0, 0.2, lambda s: 0.3),
        _towards("corotated"),
        "another elastic law at large strain: on the way from the base law to the corotated one",
    ),
    _nonlinear(
        "softening",
        Dose("green_share", "", 0.0, 1.0, 0.2, lambda s: 0.3),
        _towards("stvk"),
        "softer the more it is pressed: on the way from the base law to Saint Venant and Kirchhoff's",
    ),
)

MATERIAL_EFFECTS: tuple[Effect, ...] = (
    DAMPING,
    DAMPING.with_trial("strong", lambda s: 0.3 * s.wave_time),
    _viscoelasticity("fast", 0.05),
    _viscoelasticity("slow", 0.5),
    PLASTICITY,
    PLASTICITY.with_trial("bulk", lambda s: _yield_trial(s, 0.12)),
    HETEROGENEITY,
    *(_inclusion((x, y, z)) for x, y, z in product((-1, 1), repeat=3)),
    *(_with_fibres(variant, axes) for variant, axes in _FIBRES.items()),
    *NONLINEAR,
)
