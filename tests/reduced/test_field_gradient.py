"""The adjoint with respect to skinning weights, against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.dynamics import Loads, Pins, Timing, simulate
from physconvex.materials import Plasticine
from physconvex.reduced import (
    CallableWeights,
    ReducedScene,
    ReducedSpace,
    rollout_of_weights,
    untrained_neural_weights,
)
from tests.reduced.sliding_scene import sliding

TIMING = Timing(frames=4, fps=48, steps_per_frame=4, tolerance=1e-11)
COUNT = 2


class Network:
    """Two weights of one hidden layer, and their θ."""

    def __init__(self, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)
        shapes = ((3, 6), (6,), (6, COUNT))
        self.parts = [torch.randn(*shape, dtype=torch.float64, generator=generator) for shape in shapes]
        self.parts[0] *= 6  # the body is 0.3 m long
        for part in self.parts:
            part.requires_grad_()

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        first, bias, last = self.parts
        return torch.tanh(x @ first + bias) @ last

    def moved(self, directions: list[torch.Tensor], amount: float) -> "Network":
        """The same with other θ."""
        other = Network(0)
        other.parts = [p.detach() + amount * d for p, d in zip(self.parts, directions, strict=True)]
        return other


def scenes(body) -> dict[str, ReducedScene]:
    """What each of them adds: everything of the sliding scene; pins, those that lead, and loads; no contact at all."""
    surface = body.space.samples.surface_points
    end = surface[np.isclose(surface[:, 0], 0.0)]
    loads = 0.02 * np.random.default_rng(3).normal(size=surface.shape)
    free = {"obstacles": (), "wind": None, "contact_damping": 0.0, "initial_coordinates": None}
    return {
        "sliding": sliding(body, seed=4, initial_coordinates=None),
        "undamped": sliding(body, seed=4, initial_coordinates=None, damping_time=0.0),
        "held": sliding(body, seed=4, **free, pins=Pins(end, 1e-3), loads=Loads(surface, loads)),
        "led": sliding(body, seed=4, **free, pins=Pins(end, 1e-3, lambda t: end + np.array([0.3 * t, 0.0, 0.0]))),
    }


@pytest.mark.parametrize("name", ["sliding", "undamped", "held", "led"])
@pytest.mark.parametrize("law", ["neo_hookean", "stvk"])
def test_derivatives_by_theta_are_those_of_differences(mixed_body, name, law):
    scene = scenes(mixed_body(1, law))[name]
    points = np.random.default_rng(6).uniform((0, 0, 0), (0.3, 0.2, 0.1), (5, 3))
    network, rng = Network(1), np.random.default_rng(7)
    target = torch.as_tensor(rng.normal(size=(TIMING.frames, len(points), 3)))

    def loss_of(function) -> torch.Tensor:
        return ((rollout_of_weights(function, COUNT, scene=scene, points=points, timing=TIMING) - target) ** 2).sum()

    loss_of(network).backward()
    found = torch.cat([part.grad.flatten() for part in network.parts])
    assert found.abs().max() > 1e-4
    for part in range(3):
        directions = [torch.zeros_like(p) for p in network.parts]
        directions[part] = torch.as_tensor(rng.normal(size=tuple(network.parts[part].shape)))
        step = 1e-5
        with torch.no_grad():
            ends = [loss_of(network.moved(directions, s)) for s in (step, -step)]
        expected = float(ends[0] - ends[1]) / (2 * step)
        slope = float((torch.cat([d.flatten() for d in directions]) * found).sum())
        assert slope == pytest.approx(expected, rel=1e-4, abs=1e-7 * float(found.abs().max())), (name, part)


def test_a_neural_field_learns_from_a_motion(mixed_body):
    """Adam on the parameters of a network whose body shall move as that of another network does."""
    scene = scenes(mixed_body(1))["held"]
    scene = replace(scene, initial_velocity=(0.0, 0.0, 0.0), initial_angular_velocity=(0.0, 0.0, 0.0))
    points = np.random.default_rng(6).uniform((0, 0, 0), (0.3, 0.2, 0.1), (20, 3))
    timing = Timing(frames=4, fps=24, steps_per_frame=4)
    space = ReducedSpace(CallableWeights(Network(1), COUNT), scene.body.space.samples)
    observed = torch.as_tensor(simulate(replace(scene, body=scene.body.with_space(space)), timing).positions(points))
    field = untrained_neural_weights(scene.body.space.samples, COUNT, generator=torch.Generator().manual_seed(2))
    leaves = [part.requires_grad_() for layer in field.layers for part in layer]
    optimiser, losses = torch.optim.Adam(leaves, lr=0.01), []
    for _ in range(20):
        optimiser.zero_grad()
        moved = rollout_of_weights(field, COUNT, scene=scene, points=points, timing=timing)
        loss = ((moved - observed) ** 2).sum() / ((observed - observed[0]) ** 2).sum()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert min(losses[-3:]) < 0.3 * losses[0]


def test_what_it_cannot_do_is_named(mixed_body):
    body, points = mixed_body(1), np.zeros((1, 3))
    with pytest.raises(InputError, match="initial_coordinates"):
        rollout_of_weights(Network(1), COUNT, scene=ReducedScene(body, initial_coordinates=body.rest), points=points)
    flowing = ReducedScene(body.with_flow(Plasticine(500.0)))
    with pytest.raises(InputError, match="flows"):
        rollout_of_weights(Network(1), COUNT, scene=flowing, points=points)
    with pytest.raises(InputError, match="function"):
        rollout_of_weights(Network(1), COUNT + 1, scene=ReducedScene(body), points=points)
