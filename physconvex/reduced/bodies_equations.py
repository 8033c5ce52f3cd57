"""The function that one time step of several bodies minimises: one Newton over the coordinates of all of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Friction, State, StepCoefficients
from physconvex.reduced.bodies import ReducedBodies
from physconvex.reduced.dense_newton import DenseNewton
from physconvex.reduced.equations import ReducedEquations
from physconvex.reduced.pair_contact import FrozenPairs, PairContact
from physconvex.reduced.surface_contact import add_surface_blocks


class _Pair:
    """A pair's contact and its place among the coordinates of all bodies."""

    def __init__(self, contact: PairContact, first: slice, second: slice) -> None:
        self.contact = contact
        self.where = np.r_[first, second]
        self.frozen: FrozenPairs | None = None


class BodiesEquations(DenseNewton):
    """Incremental potential of one time step; coordinates of all bodies below each other, [R_1 + R_2 + …, 3]."""

    friction: tuple[Friction, ...] = ()  # it is in the equations of each body

    def __init__(self, world: ReducedBodies) -> None:
        super().__init__(world.size)
        self.world, self.slices = world, world.slices
        self.bodies = [ReducedEquations(scene) for scene in world.scenes]
        self.pairs = [_Pair(contact, self.slices[a], self.slices[b]) for a, b, contact in world.pairs()]
        self.rounding = max(body.rounding for body in self.bodies)

    def _parts(self, x: np.ndarray) -> list[tuple[ReducedEquations, np.ndarray]]:
        return [(body, x[where]) for body, where in zip(self.bodies, self.slices, strict=True)]

    # -- fixed during a step

    def set_step(self, coefficients: StepCoefficients, time: float, guess: np.ndarray, last: State) -> None:
        """Fix everything that is constant during one time step, as `ReducedEquations` does for one body."""
        self.begin(coefficients)
        for body, where in zip(self.bodies, self.slices, strict=True):
            own = StepCoefficients(coefficients.step, coefficients.target[where], coefficients.base[where])
            state = State(last.time, last.positions[where], last.velocities[where])
            body.set_step(own, time, guess[where], state)
        self._freeze(last.positions, coefficients.velocity(guess))

    def freeze_friction(self, y: Float[np.ndarray, "R 3"]) -> bool:
        """Update friction at coordinates y; returns whether there are frozen terms."""
        assert self.coefficients is not None
        own = [body.freeze_friction(part) for body, part in self._parts(y)]
        self._freeze(y, self.coefficients.velocity(y))
        return any(own) or any(pair.frozen is not None for pair in self.pairs)

    def _freeze(self, y: np.ndarray, velocity: np.ndarray) -> None:
        self.secants.interrupt()
        for pair in self.pairs:
            pair.frozen = pair.contact.freeze(y[pair.where], velocity[pair.where])

    def settled(self, change: Float[np.ndarray, "R 3"], step: float) -> bool:
        """Whether the velocities of all surfaces change by at most their slip velocities."""
        return all(body.settled(part, step) for body, part in self._parts(change))

    def commit(self, x: Float[np.ndarray, "R 3"]) -> None:
        """Store the flow at the end of a step with coordinates x."""
        for body, part in self._parts(x):
            body.commit(part)

    def flowed(self) -> tuple[np.ndarray | None, ...]:
        """F_f at the interior samples of each body; None for an elastic one."""
        return tuple(flow for body in self.bodies for flow in body.flowed())

    # -- value, gradient, Hessian

    def energy(self, state: State) -> float:
        """Of all bodies and of the contact between them [J]."""
        x, v = state.positions, state.velocities
        bodies = zip(self.bodies, self.slices, strict=True)
        own = sum(body.energy(State(state.time, x[where], v[where])) for body, where in bodies)
        return own + sum(pair.contact.energy_and_gradient(x[pair.where])[0] for pair in self.pairs)

    def evaluate(self, x: Float[np.ndarray, "R 3"]) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Incremental potential [J] and its derivative [N]."""
        found = [body.evaluate(part) for body, part in self._parts(x)]
        energy, gradient = sum(value for value, _ in found), np.concatenate([slope for _, slope in found])
        for pair in self.pairs:
            touch, push = pair.contact.energy_and_gradient(x[pair.where])
            energy, gradient[pair.where] = energy + touch, gradient[pair.where] + push
            if pair.frozen is not None and self.coefficients is not None:
                loss, drag = pair.frozen.energy_and_gradient(self.coefficients.velocity(x)[pair.where])
                energy += self.coefficients.step * loss
                gradient[pair.where] += drag
        self.secants.note(x, gradient)
        return energy, gradient

    def hessian_blocks(self, x: Float[np.ndarray, "R 3"], *, project: bool) -> Float[np.ndarray, "3 R 3 R"]:
        """Second derivative [N/m], components first; for contact between bodies always the positive part."""
        matrix = np.zeros((3, len(x), 3, len(x)))
        for body, where in zip(self.bodies, self.slices, strict=True):
            matrix[:, where, :, where] = body.hessian_blocks(x[where], project=project)
        for pair in self.pairs:
            self._add(matrix, pair, *pair.contact.stiffness(x[pair.where]))
            if pair.frozen is not None and self.coefficients is not None:
                self._add(matrix, pair, pair.frozen.rows, pair.frozen.blocks / self.coefficients.step)
        return matrix

    @staticmethod
    def _add(matrix: np.ndarray, pair: _Pair, rows: np.ndarray, blocks: np.ndarray) -> None:
        if len(rows):
            wide = np.zeros((len(rows), matrix.shape[1]))
            wide[:, pair.where] = rows
            add_surface_blocks(matrix, wide, blocks)
