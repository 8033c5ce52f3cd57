"""Rendered pixels against E, ν and the network of the weights: one backward pass, and the fit of the weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from tests.identify.conftest import FILM_TRUE, FRAMES

if TYPE_CHECKING:
    from physconvex.convex import ConvexField
    from physconvex.identify import PhotometricObservations, Twin
    from physconvex.reduced import NeuralWeights

NAMES = ("log10_youngs_modulus", "poisson_ratio")


def network(twin: Twin, seed: int, count: int = 2) -> NeuralWeights:
    from physconvex.reduced import NeuralFieldOptions, untrained_neural_weights

    options = NeuralFieldOptions(hidden_size=8, hidden_layers=1)
    samples = twin.scene.body.space.samples
    return untrained_neural_weights(samples, count, generator=torch.Generator().manual_seed(seed), options=options)


@pytest.fixture(scope="module")
def neural_twin(painted_twin: Twin, painted_box: ConvexField) -> Twin:
    """The painted box of the film with few samples, and weights of an untrained network."""
    from physconvex.identify import convex_twin, with_few_samples

    found = with_few_samples(convex_twin(painted_twin, painted_box, network(painted_twin, 3)))
    return found.with_values(NAMES, FILM_TRUE[:2] + np.array([0.1, -0.03]))


def directions(weights: NeuralWeights) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Of θ and of (log10 E, ν): each of these alone, then a random one in each part of each layer."""
    generator, theta = torch.Generator().manual_seed(5), torch.zeros_like(weights.theta)
    for unit in torch.eye(2, dtype=torch.float64):
        yield theta, unit
    begin = 0
    for part in (part for layer in weights.layers for part in layer):
        along = theta.clone()
        along[begin : begin + part.numel()] = torch.randn(part.numel(), dtype=torch.float64, generator=generator)
        begin += part.numel()
        yield along, torch.zeros(2, dtype=torch.float64)


@pytest.mark.parametrize("change", [{}, {"exposure": False, "robust_scale": np.inf}, {"blur": 1.2}])
def test_the_loss_is_the_misfit_of_the_pixels(
    painted_twin: Twin, box_film: PhotometricObservations, change: dict[str, float]
) -> None:
    from physconvex.identify import ReducedModel, misfit_of, simulation_loss

    seen = replace(box_film, **change)  # type: ignore[arg-type]
    positions = ReducedModel(painted_twin, NAMES, seen.points, FRAMES).positions(FILM_TRUE[:2] + np.array([0.3, 0]))
    expected = 2 * seen.sigma**2 / seen.sizes.sum() * misfit_of(seen, positions)
    found = simulation_loss(torch.as_tensor(positions), [seen])
    assert float(found) == pytest.approx(expected, rel=1e-6) and not found.requires_grad
    twice = np.concatenate([positions, positions], axis=1)
    assert float(simulation_loss(torch.as_tensor(twice), [seen, seen])) == pytest.approx(float(found), rel=1e-9)


@pytest.mark.parametrize(
    ("integrator", "change"),
    [("implicit_euler", {"exposure": False, "robust_scale": np.inf}), ("bdf2", {"blur": 1.2})],
)
def test_one_backward_pass_gives_the_derivatives_of_differences_through_contact(
    neural_twin: Twin, box_film: PhotometricObservations, integrator: str, change: dict[str, float]
) -> None:
    """dL/dE, dL/dν and dL/dθ along random directions, from the image to the network."""
    from physconvex.identify import moved_points, simulation_loss
    from physconvex.reduced import parameter_values

    seen, weights = replace(box_film, **change), network(neural_twin, 3)  # type: ignore[arg-type]
    timing = replace(neural_twin.timing(FRAMES), integrator=integrator, tolerance=1e-11)

    def positions_of(theta: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        network = weights.with_theta(theta)
        return moved_points(neural_twin, network, seen.points, timing, parameters=NAMES, values=values)

    values = torch.tensor(parameter_values(neural_twin.scene, NAMES), requires_grad=True)
    theta = weights.theta.clone().requires_grad_()
    positions = positions_of(theta, values)
    lowest = positions.detach()[..., 2].amin(dim=1)
    assert lowest[0] > 0 and lowest[-1] < 0.002  # it has landed
    simulation_loss(positions, [seen]).backward()
    assert values.grad is not None and theta.grad is not None
    slopes, expected, step = [], [], 1e-5
    for along_theta, along_values in directions(weights):
        with torch.no_grad():
            ends = [
                float(simulation_loss(positions_of(theta + s * along_theta, values + s * along_values), [seen]))
                for s in (step, -step)
            ]
        expected.append((ends[0] - ends[1]) / (2 * step))
        slopes.append(float(theta.grad @ along_theta + values.grad @ along_values))
    assert abs(slopes[-1]) < 1e-9  # the last bias adds constants, which the constant weight holds already
    assert np.abs(expected[:-1]).min() > 1e-6
    np.testing.assert_allclose(slopes[:-1], expected[:-1], rtol=1e-3)


@pytest.mark.slow
def test_weights_follow_the_images_as_far_as_the_energy_lets_them(
    neural_twin: Twin, box_film: PhotometricObservations
) -> None:
    """The film is that of eigenmodes: random weights move otherwise, and can come nearer."""
    from physconvex.identify import ReducedModel, WeightFitOptions, fit_weights, simulation_loss

    seen = [replace(box_film, exposure=False)]
    free = fit_weights(neural_twin, seen, options=WeightFitOptions(evaluations=5, hold=0.0))
    held = fit_weights(neural_twin, seen, options=WeightFitOptions(evaluations=5, hold=100.0))
    assert np.nanmin(free.image_losses) < 0.9 * free.image_losses[0]
    at_the_end = [simulation_loss(torch.as_tensor(_film(one.twin, seen[0])), seen) for one in (free, held)]
    assert float(at_the_end[0]) == pytest.approx(np.nanmin(free.image_losses), rel=1e-6)
    assert held.energies[-1] < held.energies[0]  # random weights are far from the energy's minimum
    names = ReducedModel(free.twin, NAMES, seen[0].points, FRAMES).names
    assert names == NAMES and free.twin.scene.body.poisson_ratio[0] == neural_twin.scene.body.poisson_ratio[0]


def _film(twin: Twin, seen: PhotometricObservations) -> np.ndarray:
    from physconvex.dynamics import simulate

    return simulate(twin.scene, twin.timing(FRAMES)).positions(seen.points)


@pytest.mark.slow
def test_turns_fit_the_material_and_the_weights(neural_twin: Twin, box_film: PhotometricObservations) -> None:
    from physconvex.identify import FitOptions, WeightFitOptions, default_parameter, fit_in_turns

    parameters = [default_parameter("log10_youngs_modulus", start=FILM_TRUE[0] + 0.2)]
    sizes = {"fit_options": FitOptions(max_iterations=2), "options": WeightFitOptions(evaluations=3)}
    alone, first = fit_in_turns(neural_twin, parameters, [box_film], turns=0, **sizes)  # type: ignore[arg-type]
    turned, last = fit_in_turns(neural_twin, parameters, [box_film], turns=1, **sizes)  # type: ignore[arg-type]
    assert last.misfit < first.misfit and len(last.values) == 1
    assert alone.scene.body.space.field is neural_twin.scene.body.space.field
    assert turned.scene.body.space.field is not neural_twin.scene.body.space.field


def test_what_cannot_be_fitted_is_named(painted_twin: Twin, box_film: PhotometricObservations) -> None:
    from physconvex import InputError
    from physconvex.identify import WeightFitOptions, fit_weights, simulation_loss

    with pytest.raises(InputError, match="NodalWeights; expected NeuralWeights"):
        fit_weights(painted_twin, [box_film])
    with pytest.raises(InputError, match=r"evaluations, hold: got 0, 1\.0"):
        WeightFitOptions(evaluations=0)
    with pytest.raises(InputError, match=r"positions: got \(2, 3, 3\)"):
        simulation_loss(torch.zeros(2, 3, 3), [box_film])
