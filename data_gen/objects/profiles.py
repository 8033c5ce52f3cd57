"""Revolved and extruded profiles: vases, bottles, rings, stars, gears, letters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import map_coordinates, spline_filter

from data_gen.objects.implicit import Field

PlaneField = Callable[[np.ndarray, np.ndarray], np.ndarray]


def polygon_distance(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Signed distance [N] of `points` [N, 2] from a closed polygon [K, 2], negative inside."""
    start, along = polygon, np.roll(polygon, -1, axis=0) - polygon
    offset = points[:, None] - start
    t = np.clip((offset * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-18), 0, 1)
    distance = np.linalg.norm(offset - t[..., None] * along, axis=2).min(axis=1)
    y, y0, y1 = points[:, 1:], start[:, 1], np.roll(start[:, 1], -1)
    left = along[:, 0] * offset[..., 1] - along[:, 1] * offset[..., 0]
    winding = ((y0 <= y) & (y < y1) & (left > 0)).sum(axis=1) - ((y1 <= y) & (y < y0) & (left < 0)).sum(axis=1)
    return np.where(winding != 0, -distance, distance)


def tabulated(polygon: np.ndarray, *, samples: int = 100) -> PlaneField:
    """Signed distance from a polygon as a cubic spline on a grid: quick for many points."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    margin = 0.35 * (high - low).max()
    low, high = low - margin, high + margin
    spacing = (high - low).max() / samples
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[a] + spacing * np.arange(counts[a]) for a in range(2)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    table = spline_filter(polygon_distance(polygon, grid.reshape(-1, 2)).reshape(counts), order=3, mode="nearest")

    def field(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        place = (np.stack([u, v]) - low[:, None]) / spacing
        return map_coordinates(table, place, order=3, mode="nearest", prefilter=False)

    return field


def revolved(rng: np.random.Generator) -> Field:
    """Solid of revolution (vase, bottle, spinning top, bowling pin), sometimes dented at the top like a cup."""
    knots = rng.integers(4, 8)
    heights = np.linspace(0, rng.uniform(1.0, 2.2), knots)
    radii = rng.uniform(0.22, 0.75, knots)
    z = np.linspace(heights[0], heights[-1], 60)
    r = PchipInterpolator(heights, radii)(z)
    outline = np.column_stack([r, z])
    if rng.random() < 0.35 and r[-1] > 0.45:
        depth = rng.uniform(0.2, 0.5) * heights[-1]
        angle = np.linspace(0, np.pi / 2, 20)
        inner = r[-1] - rng.uniform(0.2, 0.28)
        outline = np.vstack([outline, np.column_stack([inner * np.cos(angle), z[-1] - depth * np.sin(angle)])])
    mirrored = np.vstack([outline, (outline * [-1, 1])[::-1]])
    profile, rounding = tabulated(mirrored), 0.04
    return lambda p: profile(np.hypot(p[:, 0], p[:, 1]), p[:, 2]) - rounding


def ring(rng: np.random.Generator) -> Field:
    """Ring with a polygonal section, like a tyre or a nut; the outside may be wavy."""
    sides, phase = rng.integers(3, 9), rng.uniform(0, 2 * np.pi)
    angle = phase + 2 * np.pi * np.arange(sides) / sides
    half = np.array([rng.uniform(0.2, 0.4), rng.uniform(0.2, 0.5)])
    profile, rounding = tabulated(np.column_stack([np.cos(angle), np.sin(angle)]) * half), 0.05
    waves, height = rng.integers(0, 9), rng.uniform(0.0, 0.08)

    def field(p: np.ndarray) -> np.ndarray:
        wave = height * np.cos(waves * np.arctan2(p[:, 1], p[:, 0])) if waves > 1 else 0.0
        return profile(np.hypot(p[:, 0], p[:, 1]) - 0.8 - wave, p[:, 2]) - rounding

    return field


def _polar(radius: np.ndarray) -> np.ndarray:
    angle = 2 * np.pi * np.arange(len(radius)) / len(radius)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def outline(rng: np.random.Generator) -> np.ndarray:
    """A star, gear, regular polygon, flower, heart, cross or crescent, vertices [K, 2] within about one unit."""
    kind = rng.choice(["star", "gear", "polygon", "flower", "heart", "cross", "crescent"])
    if kind == "star":
        n = rng.integers(4, 8)
        return _polar(np.tile([1.0, rng.uniform(0.5, 0.7)], n))
    if kind == "gear":
        n = rng.integers(6, 11)
        inner = rng.uniform(0.75, 0.85)
        return _polar(np.tile([1.0, 1.0, inner, inner], n))
    if kind == "polygon":
        return _polar(np.ones(rng.integers(3, 7))) * [1.0, rng.uniform(0.6, 1.0)]
    angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    if kind == "flower":
        return _polar(0.82 + rng.uniform(0.1, 0.18) * np.cos(rng.integers(3, 8) * angle))
    if kind == "heart":
        x = 16 * np.sin(angle) ** 3
        y = 13 * np.cos(angle) - 5 * np.cos(2 * angle) - 2 * np.cos(3 * angle) - np.cos(4 * angle)
        return np.column_stack([x, y])[::-1] / 17
    if kind == "cross":
        a, b = rng.uniform(0.3, 0.4), rng.uniform(0.8, 1.0)
        quarter = np.array([[a, -a], [b, -a], [b, a], [a, a]])
        turn = np.array([[0, 1], [-1, 0]])
        return np.vstack([quarter @ np.linalg.matrix_power(turn, k) for k in range(4)])[:, :] * 1.0
    half = np.linspace(-1.0, 1.0, 48) * rng.uniform(1.9, 2.5)
    middle, width = 0.72, rng.uniform(0.2, 0.28)
    taper = width * np.sqrt(np.clip(1 - 0.6 * (half / half[-1]) ** 2, 0, 1))
    outer, inner = middle + taper, middle - taper
    rim = np.column_stack([outer * np.cos(half), outer * np.sin(half)])
    back = np.column_stack([inner * np.cos(half), inner * np.sin(half)])[::-1]
    return np.vstack([rim, back])


def extruded(rng: np.random.Generator) -> Field:
    """An outline with thickness and rounded edges, sometimes twisted a little, sometimes with a round hole."""
    rounding = rng.uniform(0.05, 0.1)
    profile = tabulated(outline(rng) * (1 - rounding))
    half, twist = rng.uniform(0.2, 0.6), rng.uniform(-0.8, 0.8) * (rng.random() < 0.3)
    hole = rng.uniform(0.15, 0.3) if rng.random() < 0.25 else 0.0

    def field(p: np.ndarray) -> np.ndarray:
        c, s = np.cos(twist * p[:, 2]), np.sin(twist * p[:, 2])
        flat = profile(c * p[:, 0] + s * p[:, 1], c * p[:, 1] - s * p[:, 0])
        if hole:
            flat = np.maximum(flat, hole - np.hypot(p[:, 0], p[:, 1]) + rounding)
        return extrusion(flat, p[:, 2], half, rounding)

    return field


def extrusion(flat: np.ndarray, z: np.ndarray, half: float, rounding: float) -> np.ndarray:
    """Field of a plane field `flat` extended to |z| < `half`, rounded by `rounding`."""
    q = np.stack([flat, np.abs(z) - half + rounding], axis=1)
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0) - rounding


# Strokes of some capital letters and digits on a grid of two by four units.
STROKES: dict[str, list[list[tuple[float, float]]]] = {
    "A": [[(0, 0), (1, 4), (2, 0)], [(0.5, 1.6), (1.5, 1.6)]],
    "C": [[(2, 3.5), (1, 4), (0, 3), (0, 1), (1, 0), (2, 0.5)]],
    "E": [[(2, 0), (0, 0), (0, 4), (2, 4)], [(0, 2), (1.6, 2)]],
    "F": [[(0, 0), (0, 4), (2, 4)], [(0, 2), (1.6, 2)]],
    "H": [[(0, 0), (0, 4)], [(2, 0), (2, 4)], [(0, 2), (2, 2)]],
    "J": [[(2, 4), (2, 1), (1, 0), (0, 0.8)]],
    "K": [[(0, 0), (0, 4)], [(2.1, 4), (0, 1.8)], [(0.7, 2.5), (2.1, 0)]],
    "L": [[(0, 4), (0, 0), (2, 0)]],
    "N": [[(0, 0), (0, 4), (2.2, 0), (2.2, 4)]],
    "O": [[(1, 0), (2, 1), (2, 3), (1, 4), (0, 3), (0, 1), (1, 0)]],
    "P": [[(0, 0), (0, 4), (1.4, 4), (2, 3.3), (2, 2.7), (1.4, 2), (0, 2)]],
    "S": [[(2, 3.5), (1, 4), (0, 3.2), (0.4, 2.3), (1.6, 1.7), (2, 0.8), (1, 0), (0, 0.5)]],
    "T": [[(1.1, 0), (1.1, 4)], [(0, 4), (2.2, 4)]],
    "U": [[(0, 4), (0, 1), (1, 0), (2, 1), (2, 4)]],
    "V": [[(0, 4), (1.1, 0), (2.2, 4)]],
    "X": [[(0, 0), (2.2, 4)], [(0, 4), (2.2, 0)]],
    "Y": [[(1.1, 0), (1.1, 2)], [(0, 4), (1.1, 2), (2.2, 4)]],
    "Z": [[(0, 4), (2.2, 4), (0, 0), (2.2, 0)]],
    "4": [[(1.6, 0), (1.6, 4), (0, 1.2), (2.2, 1.2)]],
    "7": [[(0, 4), (2.1, 4), (0.6, 0)]],
}


def letter(rng: np.random.Generator) -> Field:
    """A capital letter or digit of thick rounded strokes."""
    strokes = STROKES[str(rng.choice(sorted(STROKES)))]
    pairs = [(line[i], line[i + 1]) for line in strokes for i in range(len(line) - 1)]
    ends = np.array(pairs) * [rng.uniform(0.9, 1.2), 1.0]
    radius, half, rounding = rng.uniform(0.38, 0.5), rng.uniform(0.4, 0.8), rng.uniform(0.1, 0.25)

    def field(p: np.ndarray) -> np.ndarray:
        flat = np.full(len(p), np.inf)
        for start, end in ends:
            along = end - start
            t = np.clip((p[:, :2] - start) @ along / (along @ along), 0, 1)
            flat = np.minimum(flat, np.linalg.norm(p[:, :2] - start - t[:, None] * along, axis=1))
        return extrusion(flat - radius + rounding, p[:, 2], half, rounding)

    return field
