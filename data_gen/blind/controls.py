"""Controls of a blind test: captures whose right answer is known to be no cause, or that of another capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from data_gen.blind.classes import same_class


@dataclass(frozen=True)
class Control:
    """What is done to a capture.

    Attributes:
        name: of the control.
        effects: hidden, beside it.
        density: stated over true.
        rough: simulated on a coarse mesh with a soft contact.
        repeats: an earlier capture with new noise.
    """

    name: str
    effects: tuple[str, ...] = ()
    density: float = 1.0
    rough: bool = False
    repeats: bool = False


CONTROLS: dict[str, Control] = {
    control.name: control
    for control in (
        Control("density", density=1.6),  # E takes it up: no cause may be named
        Control("numerics", rough=True),  # no cause may be named, or a numerical one
        Control("camera", effects=("camera_pose",)),  # never a material
        Control("noise", repeats=True),  # the answer must be that of the first time
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
    """Every control that was answered."""
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
