"""Two ways of flowing at once."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.dynamics import Timing, simulate, simulate_with_sensitivities
from physconvex.fem import ElasticBody, NodePins, Scene
from physconvex.materials import Flows, Plasticine, Sand, StandardLinearSolid, stored_flows
from physconvex.mesh import box_mesh
from physconvex.reduced import BodySamples, NamedParameters, ReducedBody, ReducedScene, ReducedSpace, eigenmode_weights

PLASTIC, RELAXING = Plasticine(2e3, "neo_hookean"), StandardLinearSolid(2.0, 0.03)


def states(count=20):
    rng = np.random.default_rng(0)
    f = np.eye(3) + 0.15 * rng.normal(size=(count, 3, 3))
    undo = np.eye(3) + 0.1 * rng.normal(size=(count, 2, 3, 3))
    undo /= np.cbrt(np.linalg.det(undo))[..., None, None]
    constants = (torch.full((count,), m, dtype=torch.float64) for m in (8e3, 1.2e4))
    return torch.as_tensor(f), torch.as_tensor(undo), *constants


@pytest.mark.parametrize("order", [(PLASTIC, RELAXING), (RELAXING, PLASTIC), (RELAXING, StandardLinearSolid(0.5, 0.2))])
def test_each_flows_by_itself_and_stresses_add_up(order):
    f, undo, mu, lam = states()
    both = Flows(*order).during(undo, f, mu, lam, 0.01)
    parts = [rule.during(undo[:, k], f, mu, lam, 0.01) for k, rule in enumerate(order)]
    for name in ("energy", "stress", "hessian"):
        expected = sum(getattr(part, name)(f) for part in parts)
        torch.testing.assert_close(getattr(both, name)(f), expected)
    torch.testing.assert_close(both.flowed(f), torch.stack([part.flowed(f) for part in parts], dim=1))
    slope = torch.zeros(3, 3, dtype=torch.float64)
    slope[0, 1] = 1e-6
    change = (both.energy(f + slope) - both.energy(f - slope)) / 2e-6
    torch.testing.assert_close(both.stress(f)[:, 0, 1], change, rtol=1e-5, atol=1e-2)


@pytest.fixture(scope="module")
def mesh():
    return box_mesh((0.2, 0.05, 0.05), (3, 1, 1), order=2)


def bent(mesh, flow, reduced):
    """Positions of a bar that is held at one end and sags."""
    held = np.flatnonzero(mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 1e-9)
    body = ElasticBody(mesh, youngs_modulus=4e4, poisson_ratio=0.3, flow=flow)
    if not reduced:
        return simulate(Scene(body, node_pins=NodePins(held)), Timing(frames=6, fps=40.0, steps_per_frame=4)).positions[
            1:
        ]
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 6), BodySamples.of_mesh(mesh))
    made = ReducedBody(space, youngs_modulus=4e4, poisson_ratio=0.3, flow=flow)
    run = simulate(ReducedScene(made), Timing(frames=6, fps=40.0, steps_per_frame=4))
    assert flow is None or run.flowed.shape == (6, len(made.mu), *stored_flows(flow), 3, 3)
    return run.positions(mesh.vertices)[1:]


@pytest.mark.parametrize("reduced", [False, True], ids=["full", "reduced"])
def test_bodies_that_do_both(mesh, reduced):
    if reduced:  # falls freely, so that nothing deforms it
        np.testing.assert_allclose(bent(mesh, Flows(PLASTIC, RELAXING), True), bent(mesh, None, True), atol=1e-7)
        return
    moved = {rule: bent(mesh, rule, False) for rule in (None, PLASTIC, RELAXING, Flows(PLASTIC, RELAXING))}
    both = moved[Flows(PLASTIC, RELAXING)]
    for rule in (None, PLASTIC, RELAXING):
        assert np.abs(both - moved[rule]).max() > 1e-3
    unyielding = bent(mesh, Flows(Plasticine(1e9, "neo_hookean"), RELAXING), False)
    np.testing.assert_allclose(unyielding, moved[RELAXING], atol=1e-6)
    np.testing.assert_allclose(bent(mesh, Flows(RELAXING, PLASTIC), False), both, atol=1e-6)


@pytest.mark.wrong_types
def test_what_cannot_be_together():
    with pytest.raises(InputError, match="both in the place of the elastic law"):
        Flows(PLASTIC, Sand(0.5))
    with pytest.raises(InputError, match="second: got two ways"):
        Flows(RELAXING, Flows(PLASTIC, RELAXING))


def test_derivatives_of_roll_outs_are_refused(mesh):
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 4), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=4e4, poisson_ratio=0.3, flow=Flows(PLASTIC, RELAXING))
    with pytest.raises(InputError, match="one way of flowing"):
        simulate_with_sensitivities(
            NamedParameters(ReducedScene(body), ["log10_youngs_modulus"]), Timing(frames=3, fps=40.0)
        )
