"""How much of a body its convexes cover."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import trimesh

from physconvex.convex import ConvexField, HalfSpaces, half_spaces, inside_union
from physconvex.errors import InputError
from physconvex.reconstruction.triangles import welded
from physconvex.render.reference import LEAST_ALPHA

__all__ = ["Coverage", "measure_coverage"]


@dataclass(frozen=True)
class Coverage:
    """Shares, by random points.

    Attributes:
        volume: of the body's volume that lies in a hull.
        drawn_volume: of the body's volume that lies in a hull that is drawn (opacity of at least 1/255).
        surface: of the body's surface that lies in a hull or within `margin` of one.
        gaps: of the volume within ten margins below the surface that lies in no hull or within `margin` of one.
        outside: volume of the hulls outside the body, over the body's volume.
        margin: [m].
        samples: random points of volume and of surface.
    """

    volume: float
    drawn_volume: float
    surface: float
    gaps: float
    outside: float
    margin: float
    samples: int


def measure_coverage(
    field: ConvexField, mesh: trimesh.Trimesh, *, margin: float, samples: int = 20_000, seed: int = 0
) -> Coverage:
    """Measure against the closed surface of the body.

    Args:
        margin: what still counts as covered [m], such as half a pixel's footprint.

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
    below = surface - rng.uniform(0, 10 * margin, (len(surface), 1)) * mesh.face_normals[faces]
    below = below[mesh.contains(below)]
    spaces = half_spaces(field.to(torch.float64))
    drawn = field.opacity >= LEAST_ALPHA
    drawn_spaces = HalfSpaces(spaces.normals[drawn], spaces.offsets[drawn])
    covered = inside_union(field, box, spaces=spaces)
    return Coverage(
        float(covered[within].mean()),
        float(inside_union(field.select(drawn), box[within], spaces=drawn_spaces).mean()),
        float(inside_union(field, surface, margin=margin, spaces=spaces).mean()),
        float(1 - inside_union(field, below, margin=margin, spaces=spaces).mean()),
        float(covered[~within].sum() / max(within.sum(), 1)),
        margin,
        samples,
    )
