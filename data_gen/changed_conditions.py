"""New conditions for an identified body, which it was not observed in: another material or force, a moving floor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from physconvex import InputError
from physconvex.dynamics import Plane
from physconvex.fem import ElasticBody, Scene

_SOFTER, _PUSH, _SWING, _RATE = 0.3, 4.0, 0.8, 2.0


def _softer(scene: Scene) -> Scene:
    """E times 0.3, contact as stiff as it was."""
    body = scene.body
    softer = ElasticBody(
        body.mesh,
        law=body.law,
        youngs_modulus=_SOFTER * body.youngs_modulus,
        poisson_ratio=body.poisson_ratio,
        density=body.density,
    )
    return replace(scene, body=softer, contact_stiffness=scene.contact().stiffness)


def _pushed(scene: Scene) -> Scene:
    """A uniform acceleration of 4 m/s² along x in addition to gravity."""
    return replace(scene, gravity=np.asarray(scene.gravity) + np.array([_PUSH, 0.0, 0.0]))


def _moving_floor(scene: Scene) -> Scene:
    """The floor slides along x with 0.8 m/s · sin(2 π 2 Hz t)."""

    def velocity(time: float) -> tuple[float, float, float]:
        return (float(_SWING * np.sin(2 * np.pi * _RATE * time)), 0.0, 0.0)

    planes = tuple(replace(o, velocity=velocity) if isinstance(o, Plane) else o for o in scene.obstacles)
    return replace(scene, obstacles=planes)


CHANGES: dict[str, Callable[[Scene], Scene]] = {
    "softer": _softer,
    "pushed": _pushed,
    "moving_floor": _moving_floor,
}


def changes_of(scene: Scene) -> tuple[str, ...]:
    """The changes that apply to a scene: a moving floor needs a floor."""
    floor = any(isinstance(o, Plane) for o in scene.obstacles)
    return tuple(name for name in CHANGES if floor or name != "moving_floor")


def changed(scene: Scene, name: str) -> Scene:
    """The same body under a change.

    Raises:
        InputError: an unknown name.
    """
    if name not in CHANGES:
        raise InputError(f"change: got {name!r}; expected one of {', '.join(CHANGES)}")
    return CHANGES[name](scene)
