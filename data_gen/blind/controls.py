"""What counts as right in a blind test: classes of effects that one take cannot distinguish, and controls.

The right answer to a control is no cause, or the answer to another capture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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


@dataclass(frozen=True)
class Control:
    """Change of a capture.

    Attributes:
        name: name of the control.
        effects: effects that are hidden in addition.
        density: stated over true density.
        rough: whether it is simulated on a coarse mesh with a soft contact.
        repeats: whether it shows an earlier capture with new noise.
    """

    name: str
    effects: tuple[str, ...] = ()
    density: float = 1.0
    rough: bool = False
    repeats: bool = False


CONTROLS: dict[str, Control] = {
    control.name: control
    for control in (
        Control("density", density=1.6),  # E compensates for it: the answer must name no cause
        Control("numerics", rough=True),  # the answer must name no cause, or a numerical one
        Control("camera", effects=("camera_pose",)),  # the answer must not be a material
        Control("noise", repeats=True),  # the answer must equal that of the repeated capture
    )
}


@dataclass(frozen=True)
class ControlScore:
    """One control: its answer, and whether that is right."""

    name: str
    capture: str
    verdict: str
    effects: tuple[str, ...]
    right: bool


def score_controls(
    labels: Sequence[dict[str, Any]], answers: dict[str, dict[str, Any]]
) -> tuple[ControlScore, ...]:  # fmt: skip
    """Scores of all controls that have an answer."""
    out = []
    for label in labels:
        answer = answers.get(label["capture"])
        if label.get("control") is None or answer is None or "error" in answer:
            continue
        names = tuple(effect["name"] for effect in answer["effects"])
        right = _right(label, answer, answers.get(label.get("repeats", "")))
        out.append(ControlScore(label["control"], label["capture"], answer["verdict"], names, right))
    return tuple(out)


def _right(label: dict[str, Any], answer: dict[str, Any], original: dict[str, Any] | None) -> bool:
    sources = {effect["source"] for effect in answer["effects"]}
    if label["control"] == "noise":
        if original is None or original.get("verdict") != answer["verdict"]:
            return False
        if answer["verdict"] != "effect":
            return True
        return same_class(original["effects"][0]["name"], answer["effects"][0]["name"])
    if answer["verdict"] != "effect":
        return True
    return label["control"] == "camera" and "material" not in sources
