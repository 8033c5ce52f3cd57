"""Plan of a blind bank: the hidden effects of each capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from data_gen.blind.cases import kinds_for
from data_gen.blind.controls import CONTROLS, Control, class_of, same_class
from data_gen.blind.explicit_cases import OUTSIDE
from physconvex import InputError
from physconvex.io import CommandLine, Options


@dataclass(frozen=True)
class Planned:
    """One capture.

    Attributes:
        effects: hidden effects.
        visibility: visibility to which their doses are scaled.
        without: names that are removed from the dictionary of its diagnosis.
        control: change by a control, or repetition of an earlier capture.
    """

    effects: tuple[str, ...]
    visibility: float
    without: tuple[str, ...] = ()
    control: Control | None = None

    @property
    def repeats(self) -> bool:
        """Whether it shows an earlier capture with new noise."""
        return self.control is not None and self.control.repeats


class Shares(Options):
    """Shares of the captures of a bank."""

    free: Annotated[float, CommandLine(flag="--effect-free")] = 0.25
    """Share of captures without an effect."""
    two: float = 0.0
    """Share of captures with two effects."""
    outside: float = 0.0
    """Share of captures with an effect outside the dictionary."""
    deleted: float = 0.0
    """Share of captures whose effect is removed from the dictionary, with its class."""


def plan_bank(
    seed: int, count: int, effects: Sequence[str], visibilities: Sequence[float], *, shares: Shares,
    controls: Sequence[str] = (),
) -> list[Planned]:  # fmt: skip
    """The captures of a bank, in random order, the controls last.

    Single effects take turns, each at one visibility after the other. A `deleted` share of the captures hides an effect
    whose class is removed from the dictionary. As many effect-free captures lose a class that they do not hide, so the
    removal does not reveal the hidden effect.

    Raises:
        InputError: no motion can show any pair of the effects, for `two`, or controls are unknown.
    """
    if set(controls) - set(CONTROLS) or ("noise" in controls and not count):
        raise InputError(
            f"controls: got {', '.join(controls)}; expected names among {', '.join(CONTROLS)}, `noise` beside a capture"
        )
    rng = np.random.default_rng([seed, 0])
    order = [effects[i] for i in rng.permutation(len(effects))]
    free, two, outside, deleted = (round(s * count) for s in (shares.free, shares.two, shares.outside, shares.deleted))
    if free + two + outside + deleted > count:
        raise InputError(f"shares: got {shares}; expected at most one in all")

    def visibility(turn: int) -> float:
        return float(visibilities[turn % len(visibilities)])

    def in_turn(number: int) -> tuple[tuple[str, ...], float]:
        return (order[number % len(order)],), visibility(number // len(order))

    plan = [Planned(*in_turn(number)) for number in range(count - free - two - outside - deleted)]
    plan += [Planned(names, seen, class_of(names[0])) for names, seen in map(in_turn, range(deleted))]
    decoys = [class_of(order[number % len(order)]) for number in range(min(deleted, free))]
    plan += [Planned((), visibility(0), decoys[i] if i < len(decoys) else ()) for i in range(free)]
    plan += [Planned((OUTSIDE[i % len(OUTSIDE)],), visibility(i)) for i in range(outside)]
    plan += [Planned(pair, visibility(i)) for i, pair in enumerate(_pairs(rng, order, two))]
    plan = [plan[i] for i in rng.permutation(len(plan))]
    return plan + [Planned(CONTROLS[name].effects, visibility(0), control=CONTROLS[name]) for name in controls]


def _pairs(rng: np.random.Generator, order: Sequence[str], count: int) -> list[tuple[str, str]]:
    """Two effects of different classes that one motion can show; the first effects take turns."""
    together = [(a, b) for a in order for b in order if a != b and not same_class(a, b) and kinds_for((a, b))]
    if count and not together:
        raise InputError(f"effects: got {', '.join(order)}; expected two that one motion can show, for `two`")
    out = []
    for number in range(count):
        here = [pair for pair in together if pair[0] == order[number % len(order)]] or together
        out.append(here[int(rng.integers(len(here)))])
    return out
