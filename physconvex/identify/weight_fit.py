"""Neural skinning weights fitted to images: θ by eq. 9, held near the data-free energy of eq. 4.

Weights that follow images alone would take up errors of E, of the contact, and of the colours. The data-free energy
keeps them a basis of deformations: it is a property of the body, which no image enters. θ is fitted at fixed E and ν,
in turns with `physconvex.identify.fit` of these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor

from physconvex.dynamics import Timing
from physconvex.errors import ConvergenceError, InputError
from physconvex.identify.image_loss import moved_points, of_visible, simulation_loss, with_few_samples
from physconvex.identify.levenberg_marquardt import Fit, FitOptions, fit
from physconvex.identify.model import ReducedModel
from physconvex.identify.observations import StackedObservations
from physconvex.identify.parameters import Parameter
from physconvex.identify.photometric import PhotometricObservations
from physconvex.identify.twin import Twin, with_weights
from physconvex.reduced import DataFreeEnergy, NeuralFieldOptions, NeuralWeights

_SEED = 0  # the same points and transforms in every evaluation of the energy
_POINTS, _TRANSFORMS = 2000, 16
_FAILED = 10.0  # times the loss at the start, where the body cannot be simulated


@dataclass(frozen=True)
class WeightFitOptions:
    """How weights are fitted.

    Attributes:
        evaluations: roll-outs with derivatives in one turn.
        hold: c of L_sim / L_sim(start) + c · energy / energy(start): how strongly the data-free energy holds them.

    Raises:
        InputError: a value out of range.
    """

    evaluations: int = 20
    hold: float = 1.0

    def __post_init__(self) -> None:
        if self.evaluations < 1 or not self.hold >= 0:
            raise InputError(
                f"evaluations, hold: got {self.evaluations}, {self.hold}; expected at least 1, and a number ≥ 0"
            )


@dataclass(frozen=True, eq=False)
class WeightFit:
    """Result of a turn.

    Attributes:
        twin: with the best weights.
        image_losses: L_sim of every evaluation, the start first, shape [N]; nan where the body cannot be simulated.
        energies: data-free energy there, shape [N].
    """

    twin: Twin
    image_losses: Float[np.ndarray, " N"]
    energies: Float[np.ndarray, " N"]


def fit_weights(
    twin: Twin,
    seen: Sequence[PhotometricObservations],
    *,
    options: WeightFitOptions | None = None,
    timing: Timing | None = None,
    shift: Float[np.ndarray, "T P 3"] | None = None,
    on_evaluation: Callable[[int], None] | None = None,
) -> WeightFit:
    """Fit the network of a convex twin's weights to images, at the twin's E and ν (L-BFGS).

    Args:
        twin: its skinning weights are `NeuralWeights`; the result has others of the same number.
        seen: images of one camera each.
        options: length and hold.
        timing: of the roll-outs, but for the number of frames; the twin's own unless given.
        shift: added to the positions of the points of all observations [m], such as a rigid drift.
        on_evaluation: called with the number of every finished one.

    Raises:
        InputError: weights that are no network.
        ConvergenceError: the body cannot be simulated at the start.
    """
    search = _Search(twin, seen, options or WeightFitOptions(), timing or twin.timing())
    search.on_evaluation, search.shift = on_evaluation, shift
    start = search.weights.theta.detach().numpy()
    search.begin(start)
    most = search.options.evaluations
    if most > 1:
        minimize(search.loss, start, jac=True, method="L-BFGS-B", options={"maxfun": most - 1, "maxiter": most})
    losses, energies = np.array(search.history).T
    return WeightFit(with_weights(twin, search.weights.with_theta(torch.tensor(search.best[1]))), losses, energies)


class _Search:
    """L_sim and data-free energy as a function of the network's parameters."""

    def __init__(
        self,
        twin: Twin,
        seen: Sequence[PhotometricObservations],
        options: WeightFitOptions,
        timing: Timing,
    ) -> None:
        field = twin.scene.body.space.field
        if not isinstance(field, NeuralWeights):
            raise InputError(
                f"twin: its skinning weights are {type(field).__name__}; expected NeuralWeights, such as "
                "convex_twin(…, 'neural') gives"
            )
        self.weights, self.seen, self.options = field, tuple(seen), options
        self.on_evaluation: Callable[[int], None] | None = None
        self.shift: np.ndarray | None = None
        self.twin = with_few_samples(twin)
        self.timing = replace(timing, frames=len(seen[0].images))
        body = self.twin.scene.body
        sizes = NeuralFieldOptions(points=_POINTS, transforms=_TRANSFORMS)
        self.energy = DataFreeEnergy(
            body.space.samples, youngs_modulus=body.youngs_modulus, poisson_ratio=body.poisson_ratio, options=sizes
        )
        self.history: list[tuple[float, float]] = []
        self.best, self.scales = (np.inf, np.zeros(0)), (1.0, 1.0)

    def begin(self, start: Float[np.ndarray, " N"]) -> None:
        """Evaluate the start, by which both terms are divided."""
        with torch.no_grad():
            image, energy = self._terms(self.weights)
        self.scales = (1 / max(float(image), 1e-12), self.options.hold / float(energy))
        self._note(float(image), float(energy), start)

    def loss(self, flat: Float[np.ndarray, " N"]) -> tuple[float, Float[np.ndarray, " N"]]:
        """Sum of both terms and its derivative."""
        theta = torch.tensor(flat, requires_grad=True)
        try:
            image, energy = self._terms(self.weights.with_theta(theta))
        except ConvergenceError:
            self._note(np.nan, np.nan, flat)
            return _FAILED * (1 + self.options.hold), np.zeros_like(flat)
        total = self.scales[0] * image + self.scales[1] * energy
        total.backward()
        assert theta.grad is not None
        self._note(float(image.detach()), float(energy.detach()), flat)
        return float(total.detach()), theta.grad.numpy()

    def _terms(self, weights: NeuralWeights) -> tuple[Tensor, Tensor]:
        energy = self.energy(weights, torch.Generator().manual_seed(_SEED))
        return simulation_loss(self._moved(weights), self.seen), energy

    def _moved(self, weights: NeuralWeights) -> Tensor:
        points = np.concatenate([one.points for one in self.seen])
        moved = moved_points(self.twin, weights, points, self.timing)
        return moved if self.shift is None else moved + torch.as_tensor(self.shift)

    def _note(self, image: float, energy: float, flat: np.ndarray) -> None:
        total = self.scales[0] * image + self.scales[1] * energy
        if total < self.best[0]:
            self.best = (total, flat.copy())
        self.history.append((image, energy))
        if self.on_evaluation is not None:
            self.on_evaluation(len(self.history))


def fit_in_turns(
    twin: Twin,
    parameters: Sequence[Parameter],
    seen: Sequence[PhotometricObservations],
    *,
    turns: int = 2,
    options: WeightFitOptions | None = None,
    timing: Timing | None = None,
    fit_options: FitOptions | None = None,
) -> tuple[Twin, Fit]:
    """Fit E, ν and other parameters of a convex twin to images, then its weights, then the parameters again, and so on.

    Args:
        twin: with `NeuralWeights`, if there are turns.
        parameters: the unknowns.
        seen: images of one camera each.
        turns: number of fits of the weights; 0: the parameters alone.
        options: of the fits of the weights.
        timing: of the roll-outs, but for the number of frames; the twin's own unless given.
        fit_options: of the fits of the parameters.

    Returns:
        the twin with the fitted weights and parameters, and the last fit of the parameters.

    Raises:
        InputError, ConvergenceError: as `fit` and `fit_weights`.
    """
    names, frames = tuple(p.name for p in parameters), len(seen[0].images)
    for turn in range(turns + 1):
        every = ReducedModel(twin, names, StackedObservations.of(seen).points, frames, timing)
        moved = every.positions(np.array([p.start for p in parameters]))
        shown = of_visible(seen, torch.as_tensor(moved))
        stacked = StackedObservations.of(shown)
        found = fit(replace(every, points=stacked.points), stacked, parameters, options=fit_options)
        twin = twin.with_values(names, found.values)
        parameters = [p.at(float(v)) for p, v in zip(parameters, found.values, strict=True)]
        if turn < turns:
            twin = fit_weights(twin, shown, options=options, timing=timing).twin
    return twin, found
