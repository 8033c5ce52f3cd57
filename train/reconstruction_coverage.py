"""Coverage of a body by its convexes: by their hulls, by their soft occupancy, and against light from all sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion

from physconvex import InputError
from physconvex.convex import ConvexField, HalfSpaces, half_spaces, inside_union, occupancies
from physconvex.io import Camera, look_at
from physconvex.reconstruction import welded
from physconvex.render import LEAST_ALPHA, render

DEPTHS = (0.0, 2.0, 4.0)  # margins below the surface at which occupancy is evaluated
SOLID = 0.5  # least occupancy of a covered place
OPEN = 0.9  # alpha below which a ray counts as passing
RIM = 2  # excluded pixels inside the outline
DISTANCE = 5.0  # of the cameras, in radii of the body


@dataclass(frozen=True)
class SoftSurface:
    """Occupancy along the surface: shares of points of it, moved inward by `depth` [m].

    Attributes:
        depth: [m].
        single: where one convex alone has opacity · O ≥ ½ (O of `ConvexField`).
        union: where all together have 1 − Π_i (1 − opacity_i O_i) ≥ ½.
    """

    depth: float
    single: float
    union: float


@dataclass(frozen=True)
class Holes:
    """Rays from all round that hit the body, two pixels or more inside its outline.

    Attributes:
        share: of them that pass (alpha below 0.9).
        worst: the same for the direction with the most.
        rays: number of rays.
        directions: number of directions.
    """

    share: float
    worst: float
    rays: int
    directions: int


@dataclass(frozen=True)
class Coverage:
    """Shares, by random points.

    Attributes:
        volume: of the body's volume that lies in a hull.
        drawn_volume: of the body's volume that lies in a hull that is drawn (opacity of at least 1/255).
        surface: of the body's surface that lies in a hull or within `margin` of one.
        gaps: of the volume within ten margins below the surface that lies in no hull or within `margin` of one.
        outside: volume of the hulls outside the body, over the body's volume.
        soft_surface: occupancy at the surface, two and four margins below it.
        holes: what passes through, in pixels of two margins.
        margin: [m].
        samples: random points of volume and of surface.
    """

    volume: float
    drawn_volume: float
    surface: float
    gaps: float
    outside: float
    soft_surface: tuple[SoftSurface, ...]
    holes: Holes
    margin: float
    samples: int


def measure_coverage(
    field: ConvexField, mesh: trimesh.Trimesh, *, margin: float, samples: int = 20_000, seed: int = 0
) -> Coverage:
    """Measure against the closed surface of the body.

    Args:
        margin: largest distance of a covered point from a hull [m], for example half a pixel's footprint.

    Raises:
        InputError: an open surface, which has no inside.
    """
    mesh = welded(mesh)
    if not mesh.is_watertight:
        raise InputError("mesh: is not watertight, so its volume is not defined; repair it")
    rng = np.random.default_rng(seed)
    low, high = mesh.bounds - np.array([[5 * margin], [-5 * margin]])
    tries = max(2, int(1.2 * samples * float(np.prod(high - low)) / abs(mesh.volume)))
    box = rng.uniform(low, high, (tries, 3))
    within = mesh.contains(box)
    surface, faces = trimesh.sample.sample_surface(mesh, samples, seed=seed)
    normals = mesh.face_normals[faces]
    below = surface - rng.uniform(0, 10 * margin, (len(surface), 1)) * normals
    below = below[mesh.contains(below)]
    field = field.to(torch.float64)
    spaces = half_spaces(field)
    seen = field.opacity >= LEAST_ALPHA
    drawn, drawn_spaces = field.select(seen), HalfSpaces(spaces.normals[seen], spaces.offsets[seen])
    covered = inside_union(field, box, spaces=spaces)
    return Coverage(
        float(covered[within].mean()),
        float(inside_union(drawn, box[within], spaces=drawn_spaces).mean()),
        float(inside_union(field, surface, margin=margin, spaces=spaces).mean()),
        float(1 - inside_union(field, below, margin=margin, spaces=spaces).mean()),
        float(covered[~within].sum() / max(within.sum(), 1)),
        tuple(_soft_surface(drawn, drawn_spaces, surface, normals, depth * margin) for depth in DEPTHS),
        measure_holes(field, mesh, pixel=2 * margin),
        margin,
        samples,
    )


def _soft_surface(
    field: ConvexField,
    spaces: HalfSpaces,
    surface: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    depth: float,
) -> SoftSurface:
    """Occupancy at points moved inward."""
    greatest, union = occupancies(field, surface - depth * normals, spaces=spaces)
    return SoftSurface(depth, float((greatest >= SOLID).mean()), float((union >= SOLID).mean()))


def measure_holes(field: ConvexField, mesh: trimesh.Trimesh, *, pixel: float, directions: int = 32) -> Holes:
    """Find places where light passes through the body, from directions spread evenly over the sphere.

    Args:
        pixel: size of a pixel at the middle of the body [m].
        directions: their number, at least one.

    Raises:
        InputError: `pixel` or `directions` not positive.
    """
    if pixel <= 0 or directions < 1:
        raise InputError(f"holes: got pixels of {pixel} m and {directions} directions; expected positive numbers")
    field = field.to(torch.float32)
    open_rays, rays = [], []
    for camera in _around(mesh, pixel, directions):
        core = binary_erosion(_outline(mesh, camera), iterations=RIM)
        with torch.no_grad():
            alpha = render(field, camera).alpha.numpy()
        open_rays.append(int((alpha[core] < OPEN).sum()))
        rays.append(int(core.sum()))
    worst = max(some / max(of, 1) for some, of in zip(open_rays, rays, strict=True))
    return Holes(sum(open_rays) / max(sum(rays), 1), worst, sum(rays), directions)


def _around(mesh: trimesh.Trimesh, pixel: float, count: int) -> list[Camera]:
    """Cameras on a Fibonacci spiral about the body, which fills their images."""
    centre = mesh.bounds.mean(axis=0)
    radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    angle = 2 * np.arcsin(1 / DISTANCE)
    size = int(np.ceil(2 * DISTANCE * radius * np.tan(angle / 2) / pixel))
    places = np.arange(count) + 0.5
    height, turn = 1 - 2 * places / count, np.pi * (1 + np.sqrt(5)) * places
    ring = np.sqrt(1 - height**2)
    ways = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    return [
        look_at(centre + DISTANCE * radius * way, centre, width=size, height=size, vertical_field_of_view=angle)
        for way in ways
    ]


def _outline(mesh: trimesh.Trimesh, camera: Camera) -> Bool[np.ndarray, "H W"]:
    """Pixels whose rays hit the body."""
    origin, directions = camera.rays()
    flat = directions.reshape(-1, 3)
    return np.asarray(mesh.ray.intersects_any(np.broadcast_to(origin, flat.shape), flat)).reshape(camera.h, camera.w)
