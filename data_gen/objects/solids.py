"""Superquadrics, blobs and boolean combinations."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from data_gen.objects.implicit import (
    Field,
    box,
    cylinder,
    ellipsoid,
    moved,
    rotation_about,
    smooth_difference,
    smooth_intersection,
    smooth_union,
    torus,
)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """Rotation matrix, uniform over all rotations."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def random_direction(rng: np.random.Generator, size: int = 3) -> Float[np.ndarray, " D"]:
    """A unit vector, uniform over all directions."""
    vector = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def superquadric(rng: np.random.Generator) -> Field:
    """Superellipsoid (Barr 1981), sometimes tapered, twisted or bent."""
    radii = rng.uniform(0.35, 1.0, 3)
    e_vertical, e_around = rng.uniform(0.3, 1.5, 2)

    def field(p: np.ndarray) -> np.ndarray:
        x, y, z = np.maximum(np.abs(p / radii), 1e-9).T
        around = (x ** (2 / e_around) + y ** (2 / e_around)) ** (e_around / e_vertical)
        return ((around + z ** (2 / e_vertical)) ** (e_vertical / 2) - 1) * radii.min()

    return deformed(field, rng)


def supertoroid(rng: np.random.Generator) -> Field:
    """Ring with a superelliptic section."""
    tube = np.array([rng.uniform(0.25, 0.5), rng.uniform(0.25, 0.6)])
    e_section, e_around = rng.uniform(0.35, 1.3), rng.uniform(0.5, 1.2)

    def field(p: np.ndarray) -> np.ndarray:
        x, y, z = np.maximum(np.abs(p), 1e-9).T
        ring = (x ** (2 / e_around) + y ** (2 / e_around)) ** (e_around / 2) - 1
        q = np.maximum(np.abs(np.stack([ring, z], axis=1) / tube), 1e-9) ** (2 / e_section)
        return (q.sum(axis=1) ** (e_section / 2) - 1) * tube.min()

    return field


def deformed(field: Field, rng: np.random.Generator) -> Field:
    """`field` after one of nothing, taper, twist, bend (inverse maps of Barr 1984), along z."""
    kind = rng.choice(["none", "taper", "twist", "bend"])
    if kind == "taper":
        slope = rng.uniform(-0.4, 0.4)
        return lambda p: field(np.column_stack([p[:, :2] / (1 + slope * np.clip(p[:, 2:], -1, 1)), p[:, 2]]))
    if kind == "twist":
        rate = rng.uniform(-1.2, 1.2)

        def twisted(p: np.ndarray) -> np.ndarray:
            c, s = np.cos(rate * p[:, 2]), np.sin(rate * p[:, 2])
            return field(np.column_stack([c * p[:, 0] + s * p[:, 1], c * p[:, 1] - s * p[:, 0], p[:, 2]]))

        return twisted
    if kind == "bend":
        curvature = rng.uniform(0.2, 0.5)
        return lambda p: field(np.column_stack([p[:, 0] + curvature * (p[:, 2] ** 2 - 0.3), p[:, 1:]]))
    return field


def blob(rng: np.random.Generator) -> Field:
    """Overlapping balls along a random walk, melted together, with gentle bumps."""
    centre, fields = np.zeros(3), []
    for _ in range(rng.integers(3, 8)):
        radius = rng.uniform(0.25, 0.5)
        fields.append(ellipsoid(centre.copy(), radius * rng.uniform(0.8, 1.25, 3)))
        centre = centre + random_direction(rng) * radius * rng.uniform(0.8, 1.3)
    body = smooth_union(fields, rng.uniform(0.15, 0.4))
    waves, phases = rng.normal(0, 3.0, (3, 3)), rng.uniform(0, 2 * np.pi, 3)
    height = rng.uniform(0.0, 0.02)
    return lambda p: body(p) - height * np.sin(p @ waves.T + phases).sum(axis=1)


def primitive(rng: np.random.Generator, size: float) -> Field:
    """One of ball, box, cylinder, ring of about the given size, turned at random."""
    kind = rng.choice(["ball", "box", "cylinder", "ring"], p=[0.3, 0.3, 0.25, 0.15])
    a, b, c = size * rng.uniform(0.55, 1.0, 3)
    if kind == "ball":
        field = ellipsoid(np.zeros(3), np.array([a, b, c]))
    elif kind == "box":
        field = box(np.array([a, b, c]), 0.2 * min(a, b, c))
    elif kind == "cylinder":
        field = cylinder(0.7 * a, b, 0.2 * min(a, b))
    else:
        field = torus(0.75 * size, 0.3 * size)
    return moved(field, rotation=random_rotation(rng))


def boolean(rng: np.random.Generator) -> Field:
    """A primitive with one to three others added, cut away or intersected, edges rounded."""
    field = primitive(rng, 1.0)
    for _ in range(rng.integers(1, 4)):
        shift = random_direction(rng) * rng.uniform(0.5, 0.9)
        operation = rng.choice(["add", "cut", "common"], p=[0.45, 0.45, 0.1])
        if operation == "add":
            field = smooth_union([field, moved(primitive(rng, rng.uniform(0.45, 0.8)), shift=shift)], 0.12)
        elif operation == "cut":
            field = smooth_difference(field, moved(primitive(rng, rng.uniform(0.35, 0.7)), shift=1.1 * shift), 0.12)
        else:
            field = smooth_intersection([field, moved(primitive(rng, 1.0), shift=0.4 * shift)], 0.12)
    axis = rng.normal(size=3)
    return moved(field, rotation=rotation_about(axis, rng.uniform(0, 0.3)))
