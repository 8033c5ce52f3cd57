"""Newton's method for B candidates at once: each has its own factor, line search and friction passes."""

from __future__ import annotations

import torch
from torch import Tensor

from physconvex.reduced.candidate_equations import CandidateEquations

__all__ = ["CandidateNewton"]

_ARMIJO, _ROUNDING = 1e-4, 1e-13
_STALE_RATE = 0.25  # ratio of a step to the one before it above which a kept factor is renewed
_ITERATIONS, _HALVINGS = 60, 12


class CandidateNewton:
    """Solves the steps of all candidates.

    Args:
        equations: their potentials.
        count: B.
        tolerance: Newton's last step [m].
        passes: friction passes at most.

    Attributes:
        failed: candidates that have not converged in some step, shape [B]; they are left where they are.
        iterations, factorisations: of each candidate, shape [B].
    """

    def __init__(self, equations: CandidateEquations, count: int, tolerance: float, passes: int) -> None:
        self.equations, self.tolerance, self.passes = equations, tolerance, passes
        device, n = equations.device, 3 * equations.size
        self.everyone = torch.arange(count, device=device)
        self.failed = torch.zeros(count, dtype=torch.bool, device=device)
        self.iterations = torch.zeros(count, dtype=torch.int64, device=device)
        self.factorisations = torch.zeros(count, dtype=torch.int64, device=device)
        self._factors = torch.zeros(count, n, n, dtype=torch.float64, device=device)
        self._factor_step = torch.full((count,), torch.nan, dtype=torch.float64, device=device)
        self._rounding = 1e-15 * float(equations.weights.sum()) * equations.mu

    def advance(self, guess: Tensor) -> Tensor:
        """New coordinates [B, R, 3] of a step that the equations have been set to."""
        y = guess.clone()
        on = torch.nonzero(~self.failed).squeeze(-1)
        self._minimise(y, on)
        if not self.equations.frozen:
            return y
        assert self.equations.now is not None
        enough = self.equations.now.duration * self.equations.contact.slip_velocity
        for _ in range(1, self.passes):
            on = on[~self.failed[on]]
            self.equations.freeze(y[on], on)
            rubs = torch.stack([part.weights[on].any(-1) for part in self.equations.frozen]).any(0)
            on = on[rubs]  # as in `simulate`: one that has just lifted off is done
            if not len(on):
                break
            before = y[on].clone()
            self._minimise(y, on)
            change = (self.equations.surface @ (y[on] - before)).abs().amax(dim=(-1, -2))
            on = on[change > enough]
        return y

    def _minimise(self, y: Tensor, on: Tensor) -> None:
        """Minimise in place for the candidates `on`."""
        if not len(on):
            return
        equations = self.equations
        assert equations.now is not None
        value, gradient = equations.evaluate(y[on], on)
        lost = ~torch.isfinite(value)  # a start without finite energy
        self.failed[on[lost]] = True
        on, value, gradient = on[~lost], value[~lost], gradient[~lost]
        fresh = torch.zeros(len(self.everyone), dtype=torch.bool, device=y.device)
        self._renew(y, on[self._factor_step[on] != equations.now.step], fresh)
        previous = torch.full((len(self.everyone),), torch.inf, dtype=torch.float64, device=y.device)
        for _ in range(_ITERATIONS):
            direction = self._solve(gradient, on)
            size = direction.abs().amax(dim=(-1, -2))
            slow = (size > _STALE_RATE * previous[on]) & (size > self.tolerance) & ~fresh[on]
            if slow.any():
                self._renew(y, on[slow], fresh)
                direction[slow] = self._solve(gradient[slow], on[slow])
                size = direction.abs().amax(dim=(-1, -2))
            self.iterations[on] += 1
            done = (size <= self.tolerance) | self.failed[on]
            kept = self.failed[on[done]][:, None, None]
            y[on[done]] += torch.where(kept, 0.0, direction[done])
            left = ~done
            on, value, gradient, direction, size = on[left], value[left], gradient[left], direction[left], size[left]
            if not len(on):
                return
            found, value, gradient = self._search(y, on, value, gradient, direction)
            previous[on], fresh[on] = torch.where(found, size, torch.inf), False
            if not found.all():
                stuck = on[~found]
                self._renew(y, stuck, fresh, project=True)
        self.failed[on] = True

    def _solve(self, gradient: Tensor, on: Tensor) -> Tensor:
        """−H⁻¹ g with the kept factors."""
        column = gradient.mT.reshape(len(on), -1, 1)
        return -torch.cholesky_solve(column, self._factors[on]).reshape(len(on), 3, -1).mT

    def _renew(self, y: Tensor, on: Tensor, fresh: Tensor, *, project: bool = False) -> None:
        """New factors; of the positive part where the Hessian has none. Marks what cannot be factorised as failed."""
        if not len(on):
            return
        assert self.equations.now is not None
        factors, trouble = torch.linalg.cholesky_ex(self.equations.hessian(y[on], on, project=project))
        bad = (trouble != 0) | ~torch.isfinite(factors).all(-1).all(-1)
        good = on[~bad]
        self._factors[good], fresh[good] = factors[~bad], True
        self._factor_step[good] = self.equations.now.step
        self.factorisations[on] += 1
        if project:
            self.failed[on[bad]] = True
        elif bad.any():
            self._renew(y, on[bad], fresh, project=True)

    def _search(
        self, y: Tensor, on: Tensor, value: Tensor, gradient: Tensor, direction: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Backtracking; y moves where a step was found. Tells where, and gives the values and gradients there."""
        slope = (gradient * direction).sum((-1, -2))
        allowance = _ROUNDING * (1 + value.abs()) + self._rounding[on]
        start, found = y[on], torch.zeros_like(self.failed[on])
        value, gradient, length = value.clone(), gradient.clone(), 1.0
        target = value.clone()
        for _ in range(_HALVINGS):
            trial = torch.nonzero(~found).squeeze(-1)
            if not len(trial):
                break
            there = start[trial] + length * direction[trial]
            new, turned = self.equations.evaluate(there, on[trial])
            limit = target[trial] + _ARMIJO * length * slope[trial] + allowance[trial]
            ok = torch.isfinite(new) & (new <= limit) & (slope[trial] < 0)
            some = trial[ok]
            y[on[some]], value[some], gradient[some] = there[ok], new[ok], turned[ok]
            found[some] = True
            length *= 0.5
        return found, value, gradient
