"""Effects of contact, of external forces and of the initial state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Wind
from physconvex.gap.effects.effect import AnyScene, Dose, Effect, Situation

Doses = Float[np.ndarray, " D"]


def rotation_vector_matrix(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation by |vector| [rad] about its direction (Rodrigues).

    `physconvex.numerics.rotation_matrix` rounds differently, and the digests of blind banks depend on the rounding.
    """
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def _vector(values: Float[np.ndarray, " 3"]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _rubbing(scene: AnyScene, doses: Doses) -> AnyScene:
    rough = tuple(replace(o, friction=max(o.friction + float(doses[0]), 0.0)) for o in scene.obstacles)
    return replace(scene, obstacles=rough)


FRICTION = Effect(
    "friction",
    "contact",
    (Dose("friction_coefficient", "", 0.0, 2.0, 0.02, lambda s: 0.1),),
    scene=_rubbing,
    applies=lambda s: s.touches,
    description="the floor rubs: tangential force up to the coefficient times the normal force",
    confusable=("gravity_tilt", "initial_spin", "wind"),
)


def _touches_a_hard_floor(situation: Situation) -> bool:
    """Whether the body touches a rigid floor; stiffness and dashpot of a soft one are base parameters."""
    return situation.touches and not situation.giving_floor


RESTITUTION = Effect(
    "restitution",
    "contact",
    (Dose("contact_damping_time", "s", 0.0, 1.0, 2e-4, lambda s: 0.05 * s.wave_time),),
    scene=lambda scene, doses: replace(scene, contact_damping=scene.contact_damping + float(doses[0])),
    applies=_touches_a_hard_floor,
    description="impact costs energy in the contact itself",
    confusable=("damping", "contact_stiffness"),
)
CONTACT_STIFFNESS = Effect(
    "contact_stiffness",
    "numerical",
    (Dose("log10_contact_stiffness_change", "decades", -2.5, 1.5, 0.1, lambda s: -0.3),),
    scene=lambda scene, doses: replace(scene, contact_stiffness=scene.contact().stiffness * 10 ** float(doses[0])),
    applies=_touches_a_hard_floor,
    description="the floor gives way more, or less, than the model's",
    confusable=("restitution", "nonlinear_elasticity"),
)


def _tilted(scene: AnyScene, doses: Doses) -> AnyScene:
    gravity = np.asarray(scene.gravity, dtype=np.float64)
    across = np.linalg.svd(gravity[None])[2][1:]  # two directions across gravity
    order = np.abs(across).argmax(1).argsort()
    across = across[order] * np.sign(across[order, np.abs(across[order]).argmax(1)])[:, None]
    turned = rotation_vector_matrix(np.radians(doses) @ across) @ gravity
    return replace(scene, gravity=_vector(turned))


TILT = Effect(
    "gravity_tilt",
    "external",
    tuple(Dose(f"angle_{i}", "deg", -20.0, 20.0, 0.2, lambda s: 1.0, plausible=5.0) for i in (1, 2)),
    scene=_tilted,
    applies=lambda s: any(s.gravity),
    description="gravity is not along the stated direction",
    confusable=("wind", "friction", "camera_pose"),
)
LINEAR_DRAG = Effect(
    "air_drag",
    "external",
    (Dose("rate", "1/s", 0.0, 20.0, 0.02, lambda s: 0.15, plausible=2.0),),
    scene=lambda scene, doses: replace(scene, air_drag=scene.air_drag + float(doses[0])),
    variant="linear",
    description="the surroundings slow every motion down in proportion to its speed",
    confusable=("time_scale", "damping"),
)


def _in_air(scene: AnyScene, doses: Doses) -> AnyScene:
    return scene if doses[0] <= 0 else replace(scene, wind=Wind(drag_coefficient=float(doses[0])))


QUADRATIC_DRAG = Effect(
    "air_drag",
    "external",
    (Dose("drag_coefficient", "", 0.0, 5000.0, 0.2, lambda s: 0.02 * 8 * s.density * s.size / 1.2 / 6),),
    scene=_in_air,
    applies=lambda s: not s.clamped,
    variant="quadratic",
    description="still air slows the surface down in proportion to the square of its speed",
    confusable=("time_scale", "damping"),
)


def _blown(scene: AnyScene, doses: Doses) -> AnyScene:
    return replace(scene, wind=Wind(velocity=_vector(np.append(doses, 0.0)))) if np.any(doses) else scene


def _wind_trial(situation: Situation) -> float:
    """Speed of a wind that pushes with 2 % of gravity: 1.2/8 · 6 L² w² = 0.02 · 9.81 ρ L³/2."""
    return float(np.sqrt(0.02 * 9.81 * situation.density * situation.size / 2 / 0.9))


WIND = Effect(
    "wind",
    "external",
    # a storm at most
    tuple(Dose(f"velocity_{axis}", "m/s", -30.0, 30.0, 0.5, _wind_trial, plausible=5.0) for axis in "xy"),
    scene=_blown,
    description="moving air pushes sideways",
    confusable=("gravity_tilt",),
)


INITIAL_VELOCITY = Effect(
    "initial_velocity",
    "initial state",
    tuple(Dose(f"velocity_{axis}", "m/s", -20.0, 20.0, 0.01, lambda s: 0.05 * np.sqrt(s.size)) for axis in "xyz"),
    scene=lambda scene, doses: replace(scene, initial_velocity=_vector(np.add(scene.initial_velocity, doses))),
    applies=lambda s: s.states_velocity,
    description="the body starts with another velocity than stated",
    confusable=("time_offset",),
)
INITIAL_SPIN = Effect(
    "initial_spin",
    "initial state",
    tuple(Dose(f"spin_{axis}", "rad/s", -50.0, 50.0, 0.02, lambda s: 0.1) for axis in "xyz"),
    scene=lambda scene, doses: replace(
        scene, initial_angular_velocity=_vector(np.add(scene.initial_angular_velocity, doses))
    ),
    applies=lambda s: s.states_spin,
    description="the body starts with another spin than stated",
    confusable=("friction", "plasticity"),
)

WORLD_EFFECTS: tuple[Effect, ...] = (
    FRICTION,
    FRICTION.with_trial("strong", lambda s: 0.4),
    RESTITUTION,
    TILT,
    LINEAR_DRAG,
    QUADRATIC_DRAG,
    WIND,
    INITIAL_VELOCITY,
    INITIAL_SPIN,
    CONTACT_STIFFNESS,
)
