"""Unlimited objects: a random body from a family, checked, scaled and coloured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.ndimage import distance_transform_edt, label

from data_gen.objects.implicit import Field, sampled, surface
from data_gen.objects.limbs import caterpillar, humanoid, octopus, quadruped, starfish
from data_gen.objects.profiles import extruded, letter, revolved, ring
from data_gen.objects.solids import blob, boolean, superquadric, supertoroid
from data_gen.surface import DrawnSurface
from physconvex import ConvergenceError, InputError

# Family -> shapes in it, each with equal probability.
FAMILIES: dict[str, tuple[Callable[[np.random.Generator], Field], ...]] = {
    "superquadric": (superquadric, superquadric, supertoroid),
    "blob": (blob,),
    "boolean": (boolean,),
    "revolved": (revolved, revolved, ring),
    "extruded": (extruded, extruded, letter),
    "toy": (quadruped, humanoid, starfish, octopus, caterpillar),
}
# Half extent of the box in which the raw shapes lie, and the grid spacing of the checks (share of the size).
RAW_EXTENT, CHECK_SPACING = 4.6, 1 / 40
# Accepted bodies lose at most this share of volume where they are thinner than MIN_THICKNESS (share of the size).
MIN_THICKNESS, THIN_SHARE = 0.12, 0.08
ATTEMPTS = 60


@dataclass(frozen=True, eq=False)
class ObjectMesh:
    """A textured triangle surface.

    Attributes:
        vertices: positions [m], shape [V, 3].
        faces: outward oriented triangles, shape [F, 3].
        name: identifies the object; objects of one name are the same.
        family: one of `FAMILIES`, or "user".
        vertex_colors: colours (sRGB), shape [V, 3], or None.
        uv: texture coordinates per vertex, origin at the lower left, shape [V, 2], or None.
        texture: image (sRGB), shape [H, W, 3], row 0 at the top (v = 1), or None.
        licence: licence of the geometry and texture, None if made here.
        signed_distance: function of points [N, 3] in the frame of `vertices`, negative inside, zero on the surface and
            approximately a distance near it; None for user meshes.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    name: str
    family: str
    vertex_colors: UInt8[np.ndarray, "V 3"] | None = None
    uv: Float[np.ndarray, "V 2"] | None = None
    texture: UInt8[np.ndarray, "H W 3"] | None = None
    licence: str | None = None
    signed_distance: Field | None = None

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the bounding box [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def size(self) -> float:
        """Largest edge of the bounding box [m]."""
        return float(np.ptp(self.vertices, axis=0).max())

    def drawn(self) -> DrawnSurface:
        """Its surface as it is drawn.

        Raises:
            InputError: it has neither colours nor a texture with coordinates.
        """
        return DrawnSurface(self.vertices, self.faces, colors=self.vertex_colors, uv=self.uv, texture=self.texture)

    def scaled(self, size: float) -> ObjectMesh:
        """The same object, centred at the origin, with the largest edge of its bounding box equal to `size` [m].

        Raises:
            InputError: `size` is not positive.
        """
        if not 0 < size < np.inf:
            raise InputError(f"size: got {size}; expected a positive length in metres")
        centre, factor, field = self.bounds.mean(axis=0), size / self.size, self.signed_distance
        return replace(
            self,
            vertices=(self.vertices - centre) * factor,
            signed_distance=None if field is None else lambda p: factor * field(p / factor + centre),
        )


def random_object(
    rng: np.random.Generator,
    *,
    families: Sequence[str] | None = None,
    triangles: int = 5000,
    min_thickness: float = MIN_THICKNESS,
) -> ObjectMesh:
    """Draw a watertight solid body in one piece, largest bounding-box edge 1 m, centred at the origin, uncoloured.

    Args:
        rng: the only source of randomness; equal states give equal objects.
        families: names from `FAMILIES` to draw from with equal probability; default: all.
        triangles: number of surface triangles aimed at (met within about a quarter).
        min_thickness: least thickness accepted, as a share of the size; a few per cent of the volume may be thinner.

    Raises:
        InputError: unknown family, or too few triangles.
        ConvergenceError: no acceptable body in 60 draws.
    """
    names = tuple(FAMILIES) if families is None else tuple(families)
    if not names or any(name not in FAMILIES for name in names):
        raise InputError(f"families: got {names}; expected some of {tuple(FAMILIES)}")
    if triangles < 100:
        raise InputError(f"triangles: got {triangles}; expected at least 100")
    family = names[rng.integers(len(names))]
    for _ in range(ATTEMPTS):
        shape = FAMILIES[family][rng.integers(len(FAMILIES[family]))]
        field = _normalised(shape(rng))
        if field is not None and _is_sound(field, min_thickness):
            return _meshed(field, family, f"{shape.__name__}-{rng.integers(2**48):012x}", triangles)
    raise ConvergenceError(f"random_object: no {family} of thickness {min_thickness} in {ATTEMPTS} draws")


def _normalised(raw: Field) -> Field | None:
    """The raw shape moved and scaled into the unit box around the origin; None if empty or out of range."""
    box = RAW_EXTENT * np.array([[-1.0] * 3, [1.0] * 3])
    values, origin = sampled(raw, box, RAW_EXTENT / 16)
    inside = np.argwhere(values < 0)
    if len(inside) == 0 or inside.min() < 2 or (inside.max(axis=0) > np.array(values.shape) - 3).any():
        return None
    low, high = (
        origin + RAW_EXTENT / 16 * (inside.min(axis=0) - 1),
        origin + RAW_EXTENT / 16 * (inside.max(axis=0) + 1),
    )
    vertices, _ = surface(raw, np.stack([low, high]), (high - low).max() / 32)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, scale = 0.5 * (low + high), float((high - low).max())
    return lambda p: raw(p * scale + centre) / scale


def _is_sound(field: Field, thickness: float) -> bool:
    """Whether the body is one piece, remains so when eroded, and is nowhere much thinner than required."""
    values, _ = sampled(field, 0.5 * np.array([[-1.0] * 3, [1.0] * 3]), CHECK_SPACING)
    inside = values < 0
    depth = distance_transform_edt(inside) * CHECK_SPACING
    if label(inside)[1] != 1 or label(depth > 0.3 * thickness)[1] != 1 or label(~inside)[1] != 1:
        return False
    core = depth > 0.5 * thickness - 0.5 * CHECK_SPACING
    if not core.any():
        return False
    opened = distance_transform_edt(~core) * CHECK_SPACING <= 0.5 * thickness + 0.5 * CHECK_SPACING
    return float((inside & ~opened).sum()) <= THIN_SHARE * float(inside.sum())


def _meshed(field: Field, family: str, name: str, triangles: int) -> ObjectMesh:
    """Surface of a normalised body with about the wanted number of triangles."""
    box = 0.5 * np.array([[-1.0] * 3, [1.0] * 3])
    spacing = 1 / 32
    _, faces = surface(field, box, spacing)
    vertices, faces = surface(field, box, spacing * np.sqrt(len(faces) / triangles))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, scale = 0.5 * (low + high), float((high - low).max())
    return ObjectMesh(
        vertices=(vertices - centre) / scale,
        faces=faces,
        name=name,
        family=family,
        signed_distance=lambda p: field(p * scale + centre) / scale,
    )
