"""Declared classes of effects that one take cannot distinguish."""

from __future__ import annotations

CONFUSION_CLASSES: tuple[frozenset[str], ...] = (
    frozenset({"damping", "viscoelasticity", "time_step", "restitution"}),
    frozenset({"gravity_tilt", "wind"}),
    frozenset({"initial_velocity", "time_offset"}),
    frozenset({"time_scale", "air_drag"}),
    frozenset({"anisotropy", "heterogeneity"}),
)


def same_class(first: str, second: str) -> bool:
    """Whether two names are equal or in one declared confusion class."""
    return first == second or any({first, second} <= group for group in CONFUSION_CLASSES)


def class_of(name: str) -> tuple[str, ...]:
    """Names of all effects in a declared class with this one, itself included."""
    together = {name}.union(*(group for group in CONFUSION_CLASSES if name in group))
    return tuple(sorted(together))
