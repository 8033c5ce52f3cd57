"""Two flow rules at once, each with a stored flow of its own: for example plasticine with a relaxing elastic part."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials.inelastic import FlowRule, FlowStep


@dataclass(frozen=True)
class FlowsStep:
    """Response of both during one time step, see `physconvex.materials.inelastic.FlowStep`: stresses add up.

    Attributes:
        undo: F_f⁻¹ of each at the start of the step, shape [..., 2, 3, 3].
        parts: their responses.
    """

    undo: Tensor
    parts: tuple[FlowStep, FlowStep]

    def energy(self, f: Tensor) -> Tensor:
        """W [J/m³]."""
        return self.parts[0].energy(f) + self.parts[1].energy(f)

    def stress(self, f: Tensor) -> Tensor:
        """First Piola–Kirchhoff stress [Pa], shape [..., 3, 3]."""
        return self.parts[0].stress(f) + self.parts[1].stress(f)

    def hessian(self, f: Tensor) -> Tensor:
        """∂P/∂F [Pa], shape [..., 9, 9]."""
        return self.parts[0].hessian(f) + self.parts[1].hessian(f)

    def flowed(self, f: Tensor) -> Tensor:
        """F_f⁻¹ of each at the end of the step, shape [..., 2, 3, 3]."""
        return torch.stack([part.flowed(f) for part in self.parts], dim=-3)


@dataclass(frozen=True)
class Flows:
    """Two flow rules in parallel, both with the same F.

    Attributes:
        first, second: the rules, at most one of which replaces the body's elastic law.

    Raises:
        InputError: both do, or one is made of two itself.
    """

    first: FlowRule
    second: FlowRule

    def __post_init__(self) -> None:
        for name in ("first", "second"):
            if isinstance(getattr(self, name), Flows):
                raise InputError(f"{name}: got two ways of flowing; expected one")
        if not (self.first.beside_law or self.second.beside_law):
            raise InputError(
                f"first, second: got {self.first} and {self.second}, both in the place of the elastic law; expected "
                "at most one such"
            )

    @property
    def beside_law(self) -> bool:
        """Whether both add to the body's elastic law."""
        return self.first.beside_law and self.second.beside_law

    @property
    def lagged(self) -> bool:
        """Whether the response of one depends on a state that is unknown before the step is solved."""
        return self.first.lagged or self.second.lagged

    def during(self, undo: Tensor, state: Tensor, mu: Tensor, lam: Tensor, step: float) -> FlowsStep:
        """The response during one step, see `FlowRule`; `undo` has shape [..., 2, 3, 3]."""
        first = self.first.during(undo[..., 0, :, :], state, mu, lam, step)
        return FlowsStep(undo, (first, self.second.during(undo[..., 1, :, :], state, mu, lam, step)))


def stored_flows(rule: FlowRule | None) -> tuple[int, ...]:
    """Shape of the stored flow at a point, before [3, 3]."""
    return (2,) if isinstance(rule, Flows) else ()
