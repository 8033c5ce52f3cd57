"""Soft toys: skeletons of capsules melted together."""

from __future__ import annotations

import numpy as np

from data_gen.objects.implicit import Field, capsule, ellipsoid, smooth_union


def _array(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float64)


def quadruped(rng: np.random.Generator) -> Field:
    """Body, head with ears and muzzle, four legs, perhaps a tail; x forward, z up."""
    length, girth = rng.uniform(0.45, 0.8), rng.uniform(0.28, 0.4)
    leg, foot = rng.uniform(0.3, 0.6), rng.uniform(0.14, 0.19)
    head, lift = rng.uniform(0.24, 0.36), rng.uniform(0.05, 0.5)
    skull = _array(length + 0.45 * head, 0, 0.3 * girth + lift)
    parts = [
        capsule(_array(-length, 0, 0), _array(length, 0, 0), girth, girth * rng.uniform(0.85, 1.1)),
        capsule(_array(length, 0, 0), skull, 0.8 * girth, 0.8 * head),
        ellipsoid(skull, head * _array(1.1, 1.0, 1.0)),
        capsule(skull, skull + head * _array(rng.uniform(0.8, 1.3), 0, -0.25), 0.6 * head, 0.5 * head),
    ]
    spread, stride = 0.62 * girth, rng.uniform(-0.15, 0.15, 4)
    for k, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        hip = _array(0.85 * length * x, spread * y, -0.3 * girth)
        parts.append(capsule(hip, hip + _array(stride[k], 0.08 * y, -0.7 * girth - leg), 1.25 * foot, foot))
    ear = head * rng.uniform(0.5, 1.1)
    for y in (1, -1):
        base = skull + head * _array(-0.1, 0.6 * y, 0.7)
        parts.append(capsule(base, base + ear * _array(-0.2, 0.5 * y, 1.0), 0.13, 0.12))
    if rng.random() < 0.7:
        root = _array(-length - 0.6 * girth, 0, 0.3 * girth)
        tip = root + rng.uniform(0.3, 0.6) * _array(-0.8, 0, rng.uniform(0.2, 1.2))
        parts.append(capsule(root, tip, 0.15, 0.13))
    return smooth_union(parts, rng.uniform(0.08, 0.18))


def humanoid(rng: np.random.Generator) -> Field:
    """Teddy: torso, head, arms, legs, perhaps ears; z up, facing x."""
    torso, width = rng.uniform(0.35, 0.6), rng.uniform(0.3, 0.42)
    head, limb = rng.uniform(0.3, 0.42), rng.uniform(0.15, 0.2)
    skull = _array(0, 0, torso + 0.75 * width + 0.7 * head)
    parts = [
        capsule(_array(0, 0, -torso), _array(0, 0, torso), width, 0.85 * width),
        ellipsoid(skull, head * _array(0.95, 1.05, 1.0)),
        capsule(_array(0, 0, torso), skull, 0.6 * width, 0.6 * head),
    ]
    for y in (1, -1):
        shoulder, hip = _array(0, 0.75 * width * y, 0.85 * torso), _array(0, 0.5 * width * y, -torso)
        reach, swing = rng.uniform(0.6, 0.9), rng.uniform(-0.6, 0.9)
        hand = shoulder + reach * _array(rng.uniform(-0.3, 0.6), np.cos(swing) * y, -np.sin(swing))
        foot = hip + rng.uniform(0.65, 0.95) * _array(rng.uniform(-0.2, 0.5), 0.35 * y, -1.0)
        parts += [capsule(shoulder, hand, limb, 0.95 * limb), capsule(hip, foot, 1.15 * limb, limb)]
        parts.append(capsule(foot, foot + _array(0.15, 0, 0), limb, limb))
    if rng.random() < 0.7:
        ear, tall = rng.uniform(0.13, 0.17), rng.choice([0.0, 0.5])
        for y in (1, -1):
            base = skull + head * _array(0, 0.7 * y, 0.75)
            parts.append(capsule(base, base + _array(0, 0.15 * tall * y, tall), ear, 0.95 * ear))
    return smooth_union(parts, rng.uniform(0.08, 0.16))


def starfish(rng: np.random.Generator) -> Field:
    """Four to seven arms in a plane around a centre."""
    arms, start = rng.integers(4, 8), rng.uniform(0, 2 * np.pi)
    thick, tip = rng.uniform(0.22, 0.3), rng.uniform(0.15, 0.2)
    parts = [ellipsoid(np.zeros(3), _array(0.45, 0.45, thick * 1.15))]
    for k in range(arms):
        angle = start + 2 * np.pi * (k + rng.uniform(-0.12, 0.12)) / arms
        end = rng.uniform(0.85, 1.15) * _array(np.cos(angle), np.sin(angle), rng.uniform(-0.15, 0.15))
        parts.append(capsule(0.2 * end, end, thick, tip))
    return smooth_union(parts, rng.uniform(0.08, 0.2))


def octopus(rng: np.random.Generator) -> Field:
    """A round head on four to six legs that point down and outwards."""
    legs, start = rng.integers(4, 7), rng.uniform(0, 2 * np.pi)
    parts = [ellipsoid(_array(0, 0, 0.3), _array(0.5, 0.5, rng.uniform(0.45, 0.65)))]
    foot, bend = rng.uniform(0.15, 0.19), rng.uniform(0.3, 0.7)
    for k in range(legs):
        angle = start + 2 * np.pi * k / legs
        out = _array(np.cos(angle), np.sin(angle), 0)
        knee = 0.55 * out + _array(0, 0, -0.3)
        parts.append(capsule(0.25 * out, knee, 0.22, foot))
        parts.append(capsule(knee, knee + bend * out + _array(0, 0, -0.6 + 0.5 * bend), foot, foot))
    return smooth_union(parts, rng.uniform(0.08, 0.15))


def caterpillar(rng: np.random.Generator) -> Field:
    """A chain of balls along a curve, with a head; also snakes and bananas."""
    count, bend = rng.integers(4, 8), rng.uniform(-0.35, 0.35)
    heading, place = rng.uniform(0, 2 * np.pi), np.zeros(3)
    radii = rng.uniform(0.26, 0.36) * (1 + rng.uniform(0, 0.25) * np.cos(np.linspace(0, np.pi, count)))
    parts, last = [], place
    for k in range(count):
        parts.append(ellipsoid(place.copy(), radii[k]))
        parts.append(capsule(last, place.copy(), 0.8 * radii[k - 1], 0.8 * radii[k]))
        last = place.copy()
        heading += bend
        place = place + 1.3 * radii[k] * _array(np.cos(heading), np.sin(heading), rng.uniform(-0.15, 0.15))
    head = rng.uniform(1.1, 1.5) * radii[0]
    parts.append(ellipsoid(_array(0, 0, 0.2 * head), head))
    return smooth_union(parts, rng.uniform(0.05, 0.2))
