"""Forward sensitivities of flow: derivatives of the stored deformation, and of the stress that depends on it.

The response of a time step is a function of F at each sample, of the stored flow, of μ and λ, of the state from which
sand takes its pressure, and of the constants of the flow rule. Its derivative along the tangents of all of them is
taken by central differences, sample by sample; nothing else is differenced. At the onset of yielding the response has a
kink, like that of contact, and the derivative is a one-sided one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials import stored_flows
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
        return self.body.forces_of(self._derivatives("stress", during, f, torch.zeros_like(self.dundo)))

    def advance(self, during: FlowingStep, x: Float[np.ndarray, "R 3"], dx: Float[np.ndarray, "P R 3"]) -> None:
        """Advance over a step with final coordinates x, whose derivative is dx."""
        f, df = self.body.deformation_gradient(x), self.body.deformation_gradient(dx)
        self.dundo = self._derivatives("flowed", during, f, df)

    def _derivatives(self, of: Literal["stress", "flowed"], during: FlowingStep, f: Tensor, df: Tensor) -> Tensor:
        """Derivatives of a part of the response along the tangents of all parameters, shape [P, Q, 3, 3]."""
        body = self.body
        inputs = during.undo, body.deformation_gradient(during.lagged), body.mu, body.lam, f
        dlagged = [body.deformation_gradient(y) for y in during.dlagged]
        tangents = zip(self.names, self.dundo, dlagged, self.dmu, self.dlam, df, strict=True)
        return torch.stack([self._along(of, name, during.step, inputs, along) for name, *along in tangents])

    def _along(
        self, of: Literal["stress", "flowed"], name: str, step: float, inputs: Sequence[Tensor], along: Sequence[Tensor]
    ) -> Tensor:
        """Derivative for changes of the inputs, and of the constant `name` of the rule if there is one."""
        relative = along[0], along[1], along[2] / inputs[2], along[3] / inputs[3], along[4]
        own = abs(1 / float(getattr(self.rule, name))) if name else 0.0
        largest = max(*(float(t.abs().max()) for t in relative), own)
        if not largest > 0:
            return torch.zeros_like(inputs[-1])
        length = _DIFFERENCE / largest

        def at(h: float) -> Tensor:
            *before, f = (given + h * change for given, change in zip(inputs, along, strict=True))
            rule: Any = self.rule
            if name:
                rule = replace(rule, **{name: getattr(rule, name) + h})
            part: Tensor = getattr(rule.during(*before, step), of)(f)
            return part

        return (at(length) - at(-length)) / (2 * length)
