"""Procedural colours: solid textures for bodies, pictures for floors and backgrounds.

Solid textures are functions of the rest position, so that they move with the body and need no unwrapping.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from data_gen.objects.solids import random_direction
from physconvex import InputError

# Points [N, 3] in body units (size 1) -> where on the palette, [N] in 0..1
Pattern = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def palette(rng: np.random.Generator, count: int) -> Float[np.ndarray, "C 3"]:
    """Colours (sRGB, 0..1) that are easy to distinguish: hues by the golden ratio, lightness alternating."""
    from matplotlib.colors import hsv_to_rgb

    hue = (rng.random() + 0.618 * np.arange(count) * rng.choice([0.1, 0.5, 1.0])) % 1.0
    saturation = rng.uniform(0.15, 0.95) * rng.uniform(0.6, 1.0, count)
    value = np.where(
        np.arange(count) % 2 == rng.integers(2), rng.uniform(0.7, 1.0, count), rng.uniform(0.25, 0.65, count)
    )
    return hsv_to_rgb(np.stack([hue, saturation, value], axis=1))


def noise(points: Float[np.ndarray, "N d"], rng: np.random.Generator, *, octaves: int = 4) -> Float[np.ndarray, " N"]:
    """Fractal value noise in 0..1 (about), features of about one unit and finer; shape [N]."""
    total, weight = np.zeros(len(points)), 0.0
    for octave in range(octaves):
        table = rng.random((16,) * points.shape[1])
        place = points * 2**octave + rng.uniform(0, 16, points.shape[1])
        total += 0.5**octave * map_coordinates(table, place.T, order=3, mode="grid-wrap")
        weight += 0.5**octave
    return np.clip(0.5 + 1.4 * (total / weight - 0.5), 0.0, 1.0)


def _frame(rng: np.random.Generator) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def plain(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One colour with gentle clouds."""
    return 0.5 * noise(rng.uniform(2, 6) * points, rng)


def stripes(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Parallel bands, wavy or straight."""
    phase = rng.uniform(3, 9) * points @ random_direction(rng) + rng.choice([0.0, 0.8]) * noise(3 * points, rng)
    bands = rng.integers(2, 5)
    return np.floor(phase * 1.0 % 1 * bands) / max(bands - 1, 1)


def checker(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cubes of two colours."""
    cells = np.floor(rng.uniform(4, 8) * points @ _frame(rng) + rng.random(3))
    return cells.sum(axis=1) % 2


def dots(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Balls of a second colour around scattered centres."""
    centres = rng.uniform(-0.6, 0.6, (rng.integers(60, 180), 3))
    distance = cKDTree(centres).query(points)[0]
    return (distance < rng.uniform(0.6, 0.9) * 0.55 * len(centres) ** (-1 / 3)).astype(float)


def cells(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Voronoi cells of random colours."""
    centres = rng.uniform(-0.6, 0.6, (rng.integers(60, 240), 3))
    return rng.random(len(centres))[cKDTree(centres).query(points)[1]]


def giraffe(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Voronoi cells of one colour with joints of another."""
    centres = rng.uniform(-0.6, 0.6, (rng.integers(60, 200), 3))
    distance = cKDTree(centres).query(points, k=2)[0]
    return (distance[:, 1] - distance[:, 0] > 0.25 * len(centres) ** (-1 / 3)).astype(float)


def marble(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Veins: a sine disturbed by noise (Perlin 1985)."""
    wave = rng.uniform(3, 7) * points @ random_direction(rng) + rng.uniform(1, 2) * noise(4 * points, rng)
    return np.abs(np.sin(np.pi * wave)) ** rng.uniform(0.4, 1.0)


def wood(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Growth rings about a tilted axis."""
    q = points @ _frame(rng) - rng.uniform(-0.5, 0.5, 3)
    radius = np.hypot(q[:, 0], q[:, 1]) + 0.08 * noise(np.column_stack([3 * q[:, :2], q[:, 2]]), rng)
    return (rng.uniform(6, 14) * radius) % 1.0


def patches(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Large irregular patches like those of a cow."""
    levels = rng.integers(2, 5)
    return np.floor(np.clip(noise(rng.uniform(3, 6) * points, rng, octaves=2), 0, 0.999) * levels) / (levels - 1)


PATTERNS: dict[str, Pattern] = {
    f.__name__: f for f in (plain, stripes, checker, dots, cells, giraffe, marble, wood, patches)
}


def _shade(place: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Colours of a piecewise linear palette at `place` in 0..1."""
    steps = np.linspace(0, 1, len(colors))
    return np.stack([np.interp(place, steps, colors[:, c]) for c in range(3)], axis=-1)


def _as_bytes(colors: np.ndarray) -> np.ndarray:
    return np.round(255 * np.clip(colors, 0, 1)).astype(np.uint8)


def vertex_colors(
    points: Float[np.ndarray, "V 3"], rng: np.random.Generator, *, pattern: str | None = None
) -> UInt8[np.ndarray, "V 3"]:
    """Colours (sRGB) of a random solid texture at the rest positions of a surface, shape [V, 3].

    Args:
        points: rest positions [m]; the texture adapts to their bounding box.
        rng: source of randomness.
        pattern: one of `PATTERNS`; default: any.

    Raises:
        InputError: unknown pattern, or `points` has a wrong shape.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise InputError(f"points: got shape {points.shape}; expected [V, 3] with V > 0")
    name = str(rng.choice(sorted(PATTERNS))) if pattern is None else pattern
    if name not in PATTERNS:
        raise InputError(f"pattern: got {name!r}; expected one of {tuple(PATTERNS)}")
    low, high = points.min(axis=0), points.max(axis=0)
    unit = (points - 0.5 * (low + high)) / max(float((high - low).max()), 1e-12)
    colors = _shade(PATTERNS[name](unit, rng), palette(rng, int(rng.integers(2, 5))))
    grain = rng.uniform(0.0, 0.25) * (noise(rng.uniform(8, 16) * unit, rng) - 0.5)
    return _as_bytes(colors + grain[:, None])


def _plane_points(size: int) -> np.ndarray:
    axis = (np.arange(size) + 0.5) / size - 0.5
    x, y = np.meshgrid(axis, axis)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(size * size)])


def _checked_size(size: int) -> int:
    if not 2 <= size <= 8192:
        raise InputError(f"size: got {size}; expected 2..8192 pixels")
    return int(size)


def floor_texture(rng: np.random.Generator, size: int) -> UInt8[np.ndarray, "H W 3"]:
    """Square picture (sRGB) of a floor: tiles, boards, carpet, concrete or terrazzo, muted colours."""
    points, kind = (
        _plane_points(_checked_size(size)),
        rng.choice(["tiles", "boards", "noise", "cells", "plain"]),
    )
    colors = palette(rng, 3)
    colors = 0.45 * colors + 0.55 * rng.uniform(0.25, 0.85)
    q = points[:, :2] * rng.uniform(6, 20)
    if kind == "tiles":
        joint = (np.abs(q % 1 - 0.5) > 0.47).any(axis=1)
        place = np.where(joint, 1.0, 0.5 * (np.floor(q).sum(axis=1) % 2) * rng.choice([0, 1]))
    elif kind == "boards":
        row = np.floor(q[:, 1])
        tint = rng.random(4096)[(row * 13 + np.floor(q[:, 0] / 4 + 0.37 * row)).astype(int) % 4096]
        grain = noise(np.column_stack([q[:, 0] * 0.5, q[:, 1] * 6]), rng)
        place = np.where(np.abs(q[:, 1] % 1 - 0.5) > 0.48, 1.0, 0.5 * tint + 0.3 * grain)
    elif kind == "cells":
        place = cells(points * rng.uniform(0.7, 1.2), rng)
    else:
        place = noise(q, rng, octaves=5) * (1.0 if kind == "noise" else 0.25)
    speckle = rng.uniform(0, 0.06) * rng.standard_normal(len(points))
    return _as_bytes(_shade(place, colors) + speckle[:, None]).reshape(size, size, 3)


def background_texture(rng: np.random.Generator, size: int) -> UInt8[np.ndarray, "H W 3"]:
    """Square picture (sRGB) of a background: plain, gradient, blurred clutter or clouds."""
    points, kind = _plane_points(_checked_size(size)), rng.choice(["plain", "gradient", "clutter", "clouds"])
    colors = 0.6 * palette(rng, 3) + 0.4 * rng.uniform(0.3, 1.0)
    if kind == "plain":
        place = np.full(len(points), rng.random())
    elif kind == "gradient":
        place = points @ random_direction(rng) + 0.5
    elif kind == "clouds":
        place = noise(points[:, :2] * rng.uniform(2, 6), rng)
    else:
        image = np.zeros((size, size))
        for _ in range(rng.integers(10, 40)):
            (y, x), (h, w) = rng.integers(0, size, 2), rng.integers(1, max(size // 3, 2), 2)
            image[y : y + h, x : x + w] = rng.random()
        place = gaussian_filter(image, rng.uniform(0.005, 0.03) * size).ravel()
    return _as_bytes(_shade(place, colors)).reshape(size, size, 3)
