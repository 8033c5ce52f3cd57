"""Definition of an effect: a named deviation from the base model, its doses and its implementation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.fem import Scene
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.thresholds import BASE_FIT
from physconvex.io import Camera
from physconvex.reduced import ReducedScene

AnyScene: TypeAlias = ReducedScene | Scene
Source = Literal["material", "contact", "external", "initial state", "observation", "numerical", "gauge"]
IN_FLIGHT: tuple[Source, ...] = ("external", "initial state", "observation")  # visible without contact


@dataclass(frozen=True)
class Situation:
    """Facts about the capture that an effect may use.

    Attributes:
        size: largest edge of the body [m].
        youngs_modulus: E of the base fit [Pa].
        density: [kg/m³].
        fps: frames per second.
        frames: number of frames.
        floor: whether there is an obstacle to touch.
        clamped: whether part of the body is held.
        touches: whether the base model touches the floor within the frames.
        giving_floor: whether stiffness and dashpot of the floor are fitted with the base parameters.
        depth: observed depth of markers in the floor [m].
        friction: stated coefficient of the floor.
        states_velocity, states_spin: whether the capture states the initial motion (otherwise it is estimated freely).
        starts_elsewhere: whether the first frame differs from the rest state by more than noise.
        peak_stress: largest von Mises stress of the base run [Pa].
        gravity: [m/s²].
        camera: the camera whose pixels are compared; None for markers in space.
    """

    size: float
    youngs_modulus: float
    density: float
    fps: float
    frames: int
    floor: bool = False
    clamped: bool = False
    touches: bool = False
    giving_floor: bool = False
    depth: float = 0.0
    friction: float = 0.0
    states_velocity: bool = True
    states_spin: bool = True
    starts_elsewhere: bool = True
    peak_stress: float = 1e3
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    camera: Camera | None = None

    @property
    def wave_time(self) -> float:
        """Transit time of an elastic wave through the body, L √(ρ/E) [s]: the scale of its vibrations."""
        return float(self.size * np.sqrt(self.density / self.youngs_modulus))

    @property
    def in_soft_floor(self) -> bool:
        """Whether markers penetrate the floor deeper than any stiff floor allows."""
        return self.depth >= BASE_FIT.deep * self.size


@dataclass(frozen=True)
class Dose:
    """One number that measures an effect.

    Attributes:
        name: name of the quantity.
        unit: SI unit, "" for a pure number.
        lower, upper: bounds.
        smallest: smallest deviation from `null` that is of interest, in the unit.
        trial: deviation from `null` for screening, from the situation; visible, but the motion stays near.
        null: value at which the effect is absent.
        shape: whether the dose only shapes the effect (a time constant, a direction) and is not screened by itself.
        threshold: whether the effect starts between `null` and the trial dose (the logarithm of a yield stress). A
            weaker effect is then a dose near the trial one, not a fraction of the way from `null`.
        plausible: standard deviation of the prior about `null`; inf for no prior.
    """

    name: str
    unit: str
    lower: float
    upper: float
    smallest: float
    trial: Callable[[Situation], float]
    null: float = 0.0
    shape: bool = False
    threshold: bool = False
    plausible: float = float("inf")

    def __post_init__(self) -> None:
        if not self.lower <= self.null <= self.upper:
            raise InputError(f"dose {self.name}: null {self.null:g} lies outside [{self.lower:g}, {self.upper:g}]")
        if not self.smallest > 0:
            raise InputError(f"dose {self.name}: smallest: got {self.smallest:g}; expected a number > 0")

    def implausibility(self, value: float) -> float:
        """½ of its squared distance from null in units of `plausible` [nats]."""
        return 0.5 * float((value - self.null) / self.plausible) ** 2

    def narrowed(self, deviation: float) -> float:
        """Information that a recording adds to the prior [nats]; inf of a dose that does not only shape an effect.

        `deviation` is the standard error, prior included; NaN if unknown.
        """
        if not self.shape or not np.isfinite(self.plausible) or not deviation > 0:
            return float("inf")
        return max(float(np.log(self.plausible / deviation)), 0.0)

    def estimate(self, amount: float, error: float, trial: float) -> tuple[float, float]:
        """Dose for a multiple (with a standard error) of the trial dose's effect, and its error, to first order."""
        if self.threshold:  # assume growth with the squared distance beyond the threshold
            share = max(amount, 0.02)
            value = trial - self.sign * 0.5 * np.log10(1 / share)
            return float(np.clip(value, self.lower, self.upper)), float(0.5 * error / share / np.log(10))
        change = trial - self.null
        return float(np.clip(self.null + amount * change, self.lower, self.upper)), error * abs(change)

    def slope(self, trial: float) -> float:
        """Change of the dose that undoes or adds the effect of the trial dose, for derivatives there."""
        return 0.4 * self.sign if self.threshold else trial - self.null

    def step(self, situation: Situation) -> float:
        """A typical step of a fit; for a threshold, however far from null, the smallest deviation of interest."""
        if self.shape:
            return 2 * self.smallest
        return self.smallest if self.threshold else max(abs(self.trial(situation)), self.smallest)

    @property
    def sign(self) -> int:
        """+1 or −1 if physics allows deviations to one side only, otherwise 0."""
        return int(self.lower >= self.null) - int(self.upper <= self.null)


@dataclass(frozen=True, eq=False)
class Patches:
    """Square patches of pictures.

    Attributes:
        light: brightness, linear in the light, shape [N, h, w].
        velocities: image velocity of the content [pixels/s], x to the right and y down, shape [N, 2].
        times: time of each after the first picture [s], shape [N].
    """

    light: Float[np.ndarray, "N h w"]
    velocities: Float[np.ndarray, "N 2"]
    times: Float[np.ndarray, " N"]


@dataclass(frozen=True)
class Effect:
    """A deviation from the base model that may explain a gap.

    Attributes:
        name: name of the effect (the same for its variants).
        source: kind of cause.
        doses: the numbers that measure it.
        scene: puts doses [D] into a reduced or a full-order scene; None if it acts on the observation alone.
        observe: puts doses into the observation: from a `PointMotion` to positions [T, P, 3]; None if unused.
        photograph: puts doses into pictures: from sharp, evenly exposed `Patches` to their light [N, h, w]; None if
            unused. Such an effect moves no point; `physconvex.gap.light.image_formation` tests it.
        ahead: time that `observe` needs beyond the last frame [s], from its time and the doses; None for no time.
        applies: whether the effect makes sense in a situation.
        variant: distinguishes forms of one effect.
        description: one line for people.
        confusable: declared effects with a similar kinematic signature.

    Raises:
        InputError: no dose, or no function that uses the doses.
    """

    name: str
    source: Source
    doses: tuple[Dose, ...]
    scene: Callable[[AnyScene, Float[np.ndarray, " D"]], AnyScene] | None = None
    observe: Callable[[PointMotion, Float[np.ndarray, " D"]], Float[np.ndarray, "T P 3"]] | None = None
    photograph: Callable[[Patches, Float[np.ndarray, " D"]], Float[np.ndarray, "N h w"]] | None = None
    ahead: Callable[[float, Float[np.ndarray, " D"]], float] | None = None
    applies: Callable[[Situation], bool] = lambda situation: True
    variant: str = ""
    description: str = ""
    confusable: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.doses:
            raise InputError(f"effect {self.name}: got no dose; expected at least one number that measures it")
        if self.source not in get_args(Source):
            expected = ", ".join(get_args(Source))
            raise InputError(f"effect {self.name}: source: got {self.source!r}; expected one of {expected}")
        acts = (self.scene, self.observe, self.photograph)
        if self.source not in ("gauge", "numerical") and not any(acts):
            raise InputError(f"effect {self.name}: acts on nothing; give it `scene`, `observe` or `photograph`")

    @property
    def label(self) -> str:
        """Name and variant."""
        return f"{self.name} ({self.variant})" if self.variant else self.name

    @property
    def null(self) -> Float[np.ndarray, " D"]:
        """Doses at which it is absent."""
        return np.array([dose.null for dose in self.doses])

    def with_trial(self, variant: str, trial: Callable[[Situation], float]) -> Effect:
        """A variant screened with another dose: an effect far from null may differ from its form near null."""
        first, *others = self.doses
        return replace(self, variant=variant, doses=(replace(first, trial=trial), *others))

    def trials(self, situation: Situation) -> list[tuple[int, Float[np.ndarray, " D"]]]:
        """Doses for screening: index of the screened dose and all doses; one entry per dose that is not a shape."""
        base = np.array([d.null + d.trial(situation) if d.shape else d.null for d in self.doses])
        out = []
        for index, dose in enumerate(self.doses):
            if not dose.shape:
                vector = base.copy()
                vector[index] = np.clip(dose.null + dose.trial(situation), dose.lower, dose.upper)
                out.append((index, vector))
        return out
