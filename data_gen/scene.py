"""One random drop from a seed and the configuration (object, material, motion), and the appearance of each view."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from data_gen.config import CameraConfig, GeneratorConfig, MotionConfig
from data_gen.objects.library import ObjectMesh, random_object
from data_gen.objects.solids import random_direction
from data_gen.objects.user_meshes import load_user_mesh, objects_from_folder
from data_gen.surface import Backdrop, DrawnSurface, Lighting
from data_gen.textures import background_texture, floor_texture, vertex_colors
from physconvex.io import Camera, look_at

# Kinds of random streams; the first number of each stream's key.
_OBJECT, _MOTION, LOOK = 0, 1, 2


def random_stream(seed: int, *key: int) -> np.random.Generator:
    """Independent random stream for one purpose; depends only on its arguments."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@dataclass(frozen=True, eq=False)
class Drop:
    """One planned simulation: a body above the floor z = 0, with its material and motion, in SI units.

    `body` is at its start; `signed_distance` is given in that frame, if known.
    """

    object_id: str
    family: str
    body: ObjectMesh
    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, " 3"]
    size: float
    youngs_modulus: float
    poisson_ratio: float
    density: float
    damping_time: float
    friction: float
    initial_velocity: tuple[float, float, float]
    initial_angular_velocity: tuple[float, float, float]

    def placed(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """Points of the frame of `body`, moved to the start of the drop [m]."""
        return points @ self.rotation.T + self.shift


@dataclass(frozen=True, eq=False)
class Look:
    """How one view of a drop looks."""

    camera: Camera
    lighting: Lighting
    backdrop: Backdrop


def split_of(object_id: str, train_share: float, validation_share: float) -> str:
    """ "train", "validation" or "test": a hash of the object decides, so no object is in two of them."""
    place = int.from_bytes(hashlib.sha256(object_id.encode()).digest()[:6], "big") / 2**48
    if place < train_share:
        return "train"
    return "validation" if place < train_share + validation_share else "test"


def draw_drop(
    config: GeneratorConfig, seed: int, simulation: int, attempt: int, *, body: ObjectMesh | None = None
) -> Drop:
    """The drop with that number; `attempt` counts replacements of failed ones, `body` is its object if known."""
    body = draw_object(config, seed, simulation, attempt) if body is None else body
    rng = random_stream(seed, _MOTION, simulation, attempt)
    motion, material = config.motion, config.material
    size = motion.size.sample(rng)
    rotation = _orientation(motion, rng)
    body = body.scaled(size)
    turned = body.vertices @ rotation.T
    lift = motion.drop_height.sample(rng) * size - turned[:, 2].min()
    direction, axis = random_direction(rng), random_direction(rng)
    return Drop(
        object_id=body.name,
        family=body.family,
        body=body,
        rotation=rotation,
        shift=np.array([0.0, 0.0, lift]),
        size=float(np.ptp(turned, axis=0).max()),
        youngs_modulus=material.youngs_modulus.sample(rng),
        poisson_ratio=material.poisson_ratio.sample(rng),
        density=material.density.sample(rng),
        damping_time=material.damping_time.sample(rng),
        friction=motion.friction.sample(rng),
        initial_velocity=tuple(motion.initial_speed.sample(rng) * direction),
        initial_angular_velocity=tuple(motion.initial_spin.sample(rng) * axis),
    )


def draw_object(config: GeneratorConfig, seed: int, simulation: int, attempt: int) -> ObjectMesh:
    """The object of the simulation with that number, before it is scaled."""
    number = simulation // config.objects.simulations_per_object
    if config.objects.folder is not None:
        paths = objects_from_folder(config.objects.folder)
        return load_user_mesh(paths[number % len(paths)])
    # A failed simulation is replaced by one of another object: most failures are meshes, which would fail again.
    return random_object(random_stream(seed, _OBJECT, number, *([attempt] if attempt else [])))


def _orientation(motion: MotionConfig, rng: np.random.Generator) -> np.ndarray:
    if motion.orientation == "given":
        return np.eye(3)
    if motion.orientation == "upright":
        return Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix()
    quaternion = rng.normal(size=4)
    return Rotation.from_quat(quaternion).as_matrix()


def surface_of(drop: Drop, rng: np.random.Generator) -> DrawnSurface:
    """The body's surface at the start, coloured by its texture or procedurally."""
    body = drop.body
    placed = drop.placed(body.vertices)
    if body.uv is not None and body.texture is not None:
        return DrawnSurface(placed, body.faces, uv=body.uv, texture=body.texture)
    colors = body.vertex_colors
    if colors is None:
        colors = vertex_colors(body.vertices / body.size, rng)
    return DrawnSurface(placed, body.faces, colors=colors)


def draw_look(
    config: GeneratorConfig,
    rng: np.random.Generator,
    path: Float[np.ndarray, "T P 3"],
    *,
    name: str,
    azimuth_deg: float | None = None,
) -> Look:
    """Camera that sees the whole path [m], light, floor and background of one view."""
    video, appearance = config.video, config.appearance
    azimuth = config.camera.azimuth_deg.sample(rng) if azimuth_deg is None else azimuth_deg
    camera = _camera(
        config.camera, rng, path.reshape(-1, 3), name=name, width=video.width, height=video.height, azimuth_deg=azimuth
    )
    key_azimuth = np.deg2rad(azimuth + 180 + appearance.key_azimuth_deg.sample(rng))
    elevation = np.deg2rad(appearance.key_elevation_deg.sample(rng))
    warmth = appearance.warmth.sample(rng)
    horizontal = np.cos(elevation) * np.array([np.sin(key_azimuth), np.cos(key_azimuth)])
    lighting = Lighting(
        direction=(float(horizontal[0]), float(horizontal[1]), float(np.sin(elevation))),
        key=appearance.key_intensity.sample(rng),
        fill=appearance.fill_intensity.sample(rng),
        ambient=appearance.ambient.sample(rng),
        color=(1 + warmth, 1.0, 1 - warmth),
        specular=appearance.specular.sample(rng),
        shadow_softness=appearance.shadow_softness.sample(rng),
    )
    floor = floor_texture(rng, 256)
    backdrop = Backdrop(floor, _background(config, rng), appearance.floor_tile.sample(rng))
    return Look(camera, lighting, backdrop)


def _background(config: GeneratorConfig, rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
    kinds = config.appearance.background_kinds
    kind = kinds[rng.integers(len(kinds))]
    if kind == "texture":
        return background_texture(rng, 256)
    top = rng.uniform(60, 250, 3)
    bottom = top if kind == "plain" else rng.uniform(60, 250, 3)
    ramp = np.linspace(0, 1, 64)[:, None, None]
    return np.broadcast_to(top * (1 - ramp) + bottom * ramp, (64, 8, 3)).astype(np.uint8)


def _camera(
    config: CameraConfig,
    rng: np.random.Generator,
    points: Float[np.ndarray, "P 3"],
    *,
    name: str,
    width: int,
    height: int,
    azimuth_deg: float,
) -> Camera:
    """Nearest camera on the drawn ray that keeps all points [m] within the margin."""
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(config.elevation_deg.sample(rng))
    field = np.deg2rad(config.field_of_view_deg.sample(rng))
    focal = 0.5 * height / np.tan(field / 2)
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    target = 0.5 * (low + high) + config.aim_jitter * extent * rng.uniform(-1, 1, 3)
    forward = np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), -np.sin(elevation)])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    offset = points - target
    margin = config.margin.sample(rng)
    across = np.maximum(np.abs(offset @ right) * 2 * focal / width, np.abs(offset @ up) * 2 * focal / height)
    distance = float((across * margin - offset @ forward).max())
    eye = target - max(distance, 1.5 * extent) * forward
    return look_at(eye, target, width=width, height=height, vertical_field_of_view=field, name=name)
