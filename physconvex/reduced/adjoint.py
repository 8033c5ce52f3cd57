"""Adjoint sensitivities: the gradient of one loss by many parameters, in one backward sweep through the roll-out.

The forward tangents of `physconvex.reduced.sensitivity`, transposed step by step: each solve H dx = −r costs one
back-substitution H λ = x̄, whatever the number of parameters. The local maps of friction and viscosity are transposed
point by point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
import torch
from jaxtyping import Float

from physconvex.dynamics import StepRecord, Timing, extrapolate, simulate
from physconvex.errors import InputError
from physconvex.materials import lame_parameters, viscous_stress
from physconvex.numerics import one_torch_thread, rotation_matrix
from physconvex.reduced.equations import ReducedEquations
from physconvex.reduced.field_gradient import FieldBars, density_gradient
from physconvex.reduced.friction_tangents import FreezeTangent, friction_tangent
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.step_derivatives import StepDerivatives
from physconvex.reduced.trajectory import ReducedTrajectory

Loss = Callable[[ReducedTrajectory], tuple[float, Float[np.ndarray, "T R 3"]]]


@dataclass(frozen=True)
class LossGradient:
    """A roll-out, its loss, and the loss's derivatives.

    Attributes:
        trajectory: the roll-out.
        loss: its loss.
        named: by the named parameters, shape [P].
        youngs_modulus: by E of each cell at fixed stiffness of contact and pins [1/Pa], shape [C].
        poisson_ratio: by ν of each cell, shape [C].
        initial_coordinates: by y(0), as `ReducedScene.start` gives it [1/m], shape [R, 3].
        initial_velocities: by ẏ(0) [s/m], shape [R, 3].
        by_density: computes `density`.
    """

    trajectory: ReducedTrajectory
    loss: float
    named: Float[np.ndarray, " P"]
    youngs_modulus: Float[np.ndarray, " C"]
    poisson_ratio: Float[np.ndarray, " C"]
    initial_coordinates: Float[np.ndarray, "R 3"]
    initial_velocities: Float[np.ndarray, "R 3"]
    by_density: Callable[[], Float[np.ndarray, " C"]] = field(repr=False)

    @cached_property
    def density(self) -> Float[np.ndarray, " C"]:
        """By ρ of each cell at the given mean velocity of the start [m³/kg], shape [C]."""
        return self.by_density()


class Bar:
    """Derivatives of the loss by one state, accumulated during the backward sweep."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.positions, self.velocities = np.zeros(shape), np.zeros(shape)


class Sweep:
    """Accumulates derivatives over the steps, last step first.

    Args:
        scene: of the roll-out.
        names: of parameters, see `physconvex.reduced.PARAMETERS`.
        field: accumulates the derivatives by the shape functions, if these are requested.
    """

    def __init__(self, scene: ReducedScene, names: Sequence[str], field: FieldBars | None = None) -> None:
        self.scene, self.body, self.field = scene, scene.body, field
        self.derivatives = StepDerivatives(scene, names)
        self.equations = ReducedEquations(scene)
        self.named = np.zeros(len(names))
        self.constant = self.body.space.affine(np.zeros((3, 3)), np.array([1.0, 0, 0]))[:, 0]  # of the function one
        self.products = np.zeros_like(self.body.mass)
        self.anchors = np.zeros(scene.start.shape)  # derivatives by the anchor coordinates of the pins
        cells = self.body.space.samples.interior.cells
        self.cells = torch.as_tensor(cells, device=self.body.device)
        points = torch.zeros(len(cells), dtype=torch.float64, device=self.body.device)
        self.mu, self.lam = points.clone(), points.clone()  # derivatives by μ and λ at the interior samples

    def back(self, record: StepRecord, after: Bar, before: Bar, history: Bar | None) -> None:
        """Carry derivatives by the state after a step to the states before it."""
        c = record.coefficients
        guess = extrapolate(record.before, record.history, record.step)
        self.equations.set_step(c, record.after.time, guess, record.before)
        step_bars = _StepBars(self.scene.start.shape)
        x_bar = after.positions + after.velocities / c.step
        step_bars.base -= after.velocities / c.step
        for number in reversed(range(len(record.passes))):
            x, self.equations.friction = record.passes[number].x, record.passes[number].friction
            force_bar = -self.equations.exact_solve(x, x_bar[None])[0]  # by the gradient of the incremental potential
            if self.field is not None:
                self.field.add_solve(self.equations, x, c.velocity(x), guess, force_bar)
            self._back_gradient(record, number, guess, force_bar, step_bars)
            places, speeds = self._back_friction(record, number, guess, force_bar, step_bars)
            step_bars.base -= speeds / c.step
            if number > 0:
                x_bar = places + speeds / c.step
            else:
                before.positions += places
                step_bars.guess += speeds / c.step
        _back_coefficients(record, step_bars, before, history)

    def _back_gradient(
        self, record: StepRecord, number: int, guess: np.ndarray, force_bar: np.ndarray, bars: _StepBars
    ) -> None:
        """All of the gradient except friction."""
        body, scene, c, x = self.body, self.scene, record.coefficients, record.passes[number].x
        state = body.deformation_gradient(guess)
        explicit = self.derivatives.explicit(self.equations, c, x, state)
        self.named += (explicit * force_bar).sum((1, 2))
        pull = (x - c.target) / c.step**2 + scene.air_drag * c.velocity(x)
        self.products += force_bar @ (pull - np.outer(self.constant, scene.uniform_acceleration(record.after.time))).T
        bars.target -= body.mass @ force_bar / c.step**2
        velocity_bar = scene.air_drag * (body.mass @ force_bar)
        if scene.wind is not None:
            blocks = self.equations.wind_blocks(c.velocity(x))
            surface = self.equations.surface
            velocity_bar += surface.T @ np.einsum("sij,sj->si", blocks, surface @ force_bar)
        if self.equations.pins is not None and self.equations.pins.motion is None:
            self.anchors -= self.equations.pins.matrix @ force_bar
        f, spread = body.deformation_gradient(x), body.deformation_gradient(force_bar)
        rate = body.deformation_gradient(c.velocity(x))
        with torch.enable_grad():
            inputs = [t.clone().requires_grad_() for t in (state, rate, body.mu, body.lam)]
            f_star, speed, mu, lam = inputs
            beta = scene.damping_time
            stress = body.law.stress(f, mu, lam) + viscous_stress(f_star, speed, beta * mu, beta * lam)
            state_bar, rate_bar, mu_bar, lam_bar = torch.autograd.grad((stress * spread).sum(), inputs)
        bars.guess += body.forces_of(state_bar)
        velocity_bar = velocity_bar + body.forces_of(rate_bar)
        bars.base -= velocity_bar / c.step
        self.mu += mu_bar
        self.lam += lam_bar

    def _back_friction(
        self, record: StepRecord, number: int, guess: np.ndarray, force_bar: np.ndarray, bars: _StepBars
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by the coordinates and velocities at which friction is frozen, by probing its local maps."""
        c, surface, contact = record.coefficients, self.equations.surface, self.equations.contact
        if not record.passes[number].friction:
            return np.zeros_like(force_bar), np.zeros_like(force_bar)
        present = c.velocity(record.passes[number].x)
        if number == 0:
            y, v, time = record.before.positions, c.velocity(guess), record.before.time
        else:
            y = record.passes[number - 1].x
            v, time = c.velocity(y), record.after.time
        named = len(self.named)
        probes = np.zeros((3, 9 + named, len(surface), 3))  # of x, v at freezing, and the present velocity
        for row in range(9):
            probes[row // 3, row, :, row % 3] = 1.0
        changes, given = np.zeros((4, 9 + named)), self.derivatives
        changes[:, 9:] = given.dlog_stiffness, given.dfriction, given.ddamping, given.drise
        frozen = FreezeTangent(surface @ y, surface @ v, time, probes[0], probes[1], *changes)
        maps = friction_tangent(contact, frozen, surface @ present, probes[2])
        pulled = (maps * (surface @ force_bar)).sum(-1)  # [9 + P, S]
        self.named += pulled[9:].sum(1)
        bars_on_surface = [pulled[3 * kind : 3 * kind + 3].T for kind in range(3)]
        if self.field is not None:
            for bar, field in zip(bars_on_surface, (y, v, present), strict=True):
                self.field.add_surface(bar, field)
        places, speeds, rates = (surface.T @ bar for bar in bars_on_surface)
        bars.base -= rates / c.step
        return places, speeds

    def finish(self, trajectory: ReducedTrajectory, loss: float, first: Bar) -> LossGradient:
        """All derivatives, at the end of the backward sweep."""
        start = self.derivatives.start()
        named = self.named + (start.positions * first.positions + start.velocities * first.velocities).sum((1, 2))
        count = self.body.space.samples.interior.cell_count
        weights = torch.as_tensor(self.body.space.samples.interior.weights, device=self.body.device)
        by_cell = [
            torch.zeros(count, dtype=torch.float64, device=self.body.device).index_add_(0, self.cells, weights * bar)
            for bar in (self.mu, self.lam)
        ]
        with torch.enable_grad():
            constants = [
                torch.tensor(a, device=self.body.device, requires_grad=True)
                for a in (self.body.youngs_modulus, self.body.poisson_ratio)
            ]
            mu, lam = lame_parameters(*constants)
            modulus, ratio = torch.autograd.grad((by_cell[0] * mu + by_cell[1] * lam).sum(), constants)
        # a rotating start makes velocities from its coordinates
        spin = np.asarray(self.scene.initial_angular_velocity, dtype=np.float64)
        positions = first.positions - np.cross(spin, first.velocities)
        center = np.cross(spin, self.constant @ first.velocities)
        positions = positions + np.outer(self.body.first_moments / self.body.total_mass, center)
        positions = positions + self.anchors
        turn = rotation_matrix(np.asarray(self.scene.initial_orientation, dtype=np.float64))
        center = center + (turn - np.eye(3)) @ (self.constant @ positions)  # R (I − R)ᵀ = R − I
        return LossGradient(
            trajectory,
            loss,
            named,
            modulus.cpu().numpy(),
            ratio.cpu().numpy(),
            positions,
            first.velocities,
            partial(density_gradient, self.body, self.products, self.scene.start, center),
        )


class _StepBars:
    """Derivatives of the loss by target, base and guess of one step."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.target, self.base, self.guess = np.zeros(shape), np.zeros(shape), np.zeros(shape)


def _back_coefficients(record: StepRecord, bars: _StepBars, before: Bar, history: Bar | None) -> None:
    """Transpose of `extrapolate` and of `bdf2` or `implicit_euler`."""
    step, short = record.step, record.coefficients.step
    before.positions += bars.guess
    before.velocities += step * bars.guess
    if history is not None:
        before.velocities += 0.5 * step * bars.guess
        history.velocities -= 0.5 * step * bars.guess
    both = bars.base + bars.target
    if record.two_step and history is not None:
        before.positions += 4 / 3 * both
        history.positions -= both / 3
        before.velocities += 4 / 3 * short * bars.target
        history.velocities -= short * bars.target / 3
    else:
        before.positions += both
        before.velocities += step * bars.target


class RecordedRollOut:
    """A roll-out that records its steps for the backward sweep.

    Args:
        scene: body, forces, initial state.
        timing: as in `simulate`.

    Attributes:
        scene: as given.
        trajectory: the roll-out.

    Raises:
        InputError: a body that flows, or options out of range.
        ConvergenceError: as in `simulate`.
    """

    def __init__(self, scene: ReducedScene, timing: Timing | None = None) -> None:
        if scene.body.flow is not None:
            raise InputError(
                f"scene: its body flows ({scene.body.flow}); the adjoint exists for elastic and Kelvin–Voigt bodies: "
                "leave out `flow`, or take `simulate_with_sensitivities`"
            )
        self.scene, self._frame_states = scene, [0]
        self._records: list[StepRecord] = []

        def observe(_: ReducedEquations, record: StepRecord) -> None:
            self._records.append(record)

        self.trajectory = simulate(
            scene, timing, observer=observe, on_frame=lambda _: self._frame_states.append(len(self._records))
        )

    def swept(self, sweep: Sweep, slope: Float[np.ndarray, "T R 3"]) -> Bar:
        """Sweep backwards from the derivatives of a loss by the coordinates at the frames; returns those by the start.

        Raises:
            InputError: a derivative of the wrong shape.
        """
        expected = self.trajectory.coordinates.shape
        if np.shape(slope) != expected:
            raise InputError(f"loss: gave a derivative of shape {np.shape(slope)}; expected {expected}")
        bars = [Bar(self.scene.start.shape) for _ in range(len(self._records) + 1)]
        for state, part in zip(self._frame_states, slope, strict=True):
            bars[state].positions += part
        for i in reversed(range(len(self._records))):
            history = bars[i - 1] if self._records[i].history is not None else None
            sweep.back(self._records[i], bars[i + 1], bars[i], history)
        return bars[0]


@one_torch_thread()
def simulate_with_adjoint(
    scene: ReducedScene,
    loss: Loss,
    timing: Timing | None = None,
    *,
    parameters: Sequence[str] = ("log10_youngs_modulus",),
) -> LossGradient:
    """Roll out, and differentiate a loss of the coordinates at the frames.

    Args:
        scene: body, forces, initial state.
        loss: gives the loss of a trajectory and its derivative by `trajectory.coordinates`, shape [T, R, 3].
        timing: as in `simulate`; the error of the gradient is that of Newton's `tolerance`.
        parameters: names, see `physconvex.reduced.PARAMETERS`, in addition to the fields of `LossGradient`.

    Raises:
        InputError: unknown names, options out of range, or a derivative of the wrong shape.
        ConvergenceError: as in `simulate`.
    """
    sweep = Sweep(scene, parameters)
    recorded = RecordedRollOut(scene, timing)
    value, slope = loss(recorded.trajectory)
    return sweep.finish(recorded.trajectory, float(value), recorded.swept(sweep, slope))
