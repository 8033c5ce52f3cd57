"""Forward sensitivities of flow: derivatives of the stored deformation, and of the stress that depends on it.

The response of a time step is a function of F at each sample, of the stored flow, of μ and λ, of the state from which
sand takes its pressure, and of the constants of the flow rule. Its derivative along the tangents of all of them is
taken by central differences, sample by sample; nothing else is differenced. At the onset of yielding the response has a
kink, like that of contact, and the derivative is a one-sided one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials import FlowRule, FlowStep, stored_flows
from physconvex.reduced.body import ReducedBody

_DIFFERENCE = 1e-6  # change of strains, and relative change of constants


@dataclass(frozen=True)
class FlowingStep:
    """Inputs of the response of a time step besides the coordinates at its end.

    Attributes:
        undo: F_f⁻¹ at its start, shape [Q, 3, 3].
        step: its length [s].
        lagged: coordinates for the lagged terms [m].
        dlagged: their derivatives by the parameters.
    """

    undo: Tensor
    step: float
    lagged: Float[np.ndarray, "R 3"]
    dlagged: Float[np.ndarray, "P R 3"]


@dataclass(frozen=True)
class _Along:
    """Tangents of the response's inputs by one parameter."""

    undo: Tensor
    state: Tensor
    mu: Tensor
    lam: Tensor
    rule: dict[str, float]


class FlowTangents:
    """Derivatives of the flow by P parameters, carried along step by step.

    Args:
        body: a body that flows.
        dmu, dlam: derivatives of the Lamé constants at the samples [Pa], shape [P, Q].
        names: of the parameters; those of the flow rule (`yield_stress`, …) act on it.

    Raises:
        InputError: the body has two flow rules.
    """

    def __init__(self, body: ReducedBody, dmu: Tensor, dlam: Tensor, names: Sequence[str]) -> None:
        assert body.flow is not None
        if stored_flows(body.flow):
            raise InputError(f"flow: got {body.flow}; derivatives of a roll-out exist for one way of flowing")
        self.body, self.rule, self.dmu, self.dlam = body, body.flow, dmu, dlam
        self.names = [name if hasattr(body.flow, name) else "" for name in names]
        self.dundo = torch.zeros(len(names), len(body.mu), 3, 3, dtype=torch.float64, device=body.device)

    def forces(self, during: FlowingStep, x: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "P R 3"]:
        """Derivatives of the flow's generalised forces at fixed coordinates x [N]."""
        f = self.body.deformation_gradient(x)
        none = torch.zeros_like(f)
        found = [
            self._along(k, during, f, none, lambda response, at: response.stress(at)) for k in range(len(self.names))
        ]
        return self.body.forces_of(torch.stack(found))

    def advance(self, during: FlowingStep, x: Float[np.ndarray, "R 3"], dx: Float[np.ndarray, "P R 3"]) -> None:
        """Advance over a step with final coordinates x, whose derivative is dx."""
        f, df = self.body.deformation_gradient(x), self.body.deformation_gradient(dx)
        found = [
            self._along(k, during, f, df[k], lambda response, at: response.flowed(at)) for k in range(len(self.names))
        ]
        self.dundo = torch.stack(found)

    def _along(
        self, k: int, during: FlowingStep, f: Tensor, df: Tensor, of: Callable[[FlowStep, Tensor], Tensor]
    ) -> Tensor:
        """Derivative of a part of the response along the tangents of parameter k."""
        body = self.body
        state, dstate = (body.deformation_gradient(y) for y in (during.lagged, during.dlagged[k]))
        along = _Along(self.dundo[k], dstate, self.dmu[k], self.dlam[k], self._rule_change(k))
        largest = max(
            *(float(t.abs().max()) for t in (along.undo, along.state, along.mu / body.mu, along.lam / body.lam, df)),
            *(abs(change / float(getattr(self.rule, name))) for name, change in along.rule.items()),
            0.0,
        )
        if not largest > 0:
            return torch.zeros_like(f)
        length = _DIFFERENCE / largest

        def at(sign: float) -> Tensor:
            h = sign * length
            rule: FlowRule = self._moved_rule({name: h * change for name, change in along.rule.items()})
            response = rule.during(
                during.undo + h * along.undo,
                state + h * along.state,
                body.mu + h * along.mu,
                body.lam + h * along.lam,
                during.step,
            )
            return of(response, f + h * df)

        return (at(1.0) - at(-1.0)) / (2 * length)

    def _rule_change(self, k: int) -> dict[str, float]:
        return {self.names[k]: 1.0} if self.names[k] else {}

    def _moved_rule(self, changes: dict[str, float]) -> FlowRule:
        rule: Any = self.rule
        return replace(rule, **{name: getattr(rule, name) + change for name, change in changes.items()})
