"""The compiled energy and stress of what flows against those of plain torch."""

import pytest
import torch

from physconvex.fem import ElasticBody
from physconvex.materials import FlowStep, Plasticine, Sand, StandardLinearSolid, principal_strains
from physconvex.mesh import box_mesh
from tests.kernels.missing import MISSING

RULES = [Plasticine(3e3), Plasticine(1e9), Sand(0.6), StandardLinearSolid(0.7, 0.05)]


def step_of(rule, f: torch.Tensor) -> FlowStep:
    generator = torch.Generator().manual_seed(1)
    undo = torch.eye(3, dtype=torch.float64) + 0.05 * torch.randn(f.shape, dtype=torch.float64, generator=generator)
    mu = 1e4 * (1 + torch.rand(f.shape[:-2], dtype=torch.float64, generator=generator))
    return rule.during(undo, f, mu, 2 * mu, 0.01)


def deformations(shape, amplitude: float) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.eye(3, dtype=torch.float64) + amplitude * torch.randn(
        *shape, 3, 3, dtype=torch.float64, generator=generator
    )


@pytest.mark.parametrize("rule", RULES, ids=["flows", "does not flow yet", "sand", "relaxes"])
@pytest.mark.parametrize("shape", [(40,), (6, 4)])
@pytest.mark.parametrize("amplitude", [1e-4, 0.2])
def test_energy_and_stress_are_those_of_plain_torch(rule, shape, amplitude, monkeypatch):
    f = deformations(shape, amplitude)
    compiled, plain = step_of(rule, f), step_of(rule, f)
    assert compiled._response(f) is not None
    energy, stress = compiled.energy(f), compiled.stress(f)
    monkeypatch.setattr(principal_strains, "STRAIN_KERNEL", MISSING)
    assert plain._response(f) is None
    torch.testing.assert_close(energy, plain.energy(f), rtol=1e-9, atol=1e-9 * float(energy.abs().max()))
    torch.testing.assert_close(stress, plain.stress(f), rtol=1e-9, atol=1e-9 * float(stress.abs().max()))


def test_stress_is_the_slope_of_the_energy():
    f = deformations((30,), 0.2)
    step, way = step_of(Plasticine(3e3), f), deformations((30,), 1.0)
    ahead, behind = (step.energy(f + s * way) for s in (1e-6, -1e-6))
    slope = (step.stress(f) * way).sum((-2, -1))
    torch.testing.assert_close((ahead - behind) / 2e-6, slope, rtol=1e-6, atol=1e-6 * float(slope.abs().max()))


def test_bodies_turned_inside_out_have_no_finite_energy_and_flat_ones_take_the_general_way():
    f = torch.diag_embed(torch.tensor([[1.0, 1.0, -1.0], [1.1, 1.0, 0.9]], dtype=torch.float64))
    step = step_of(Plasticine(3e3), f)
    assert step._response(f) is not None
    assert step.energy(f)[0] == torch.inf and torch.isfinite(step.energy(f)[1])
    flat = torch.diag_embed(torch.tensor([[1.0, 1.0, 0.0], [1.1, 1.0, 0.9]], dtype=torch.float64))
    assert step._response(flat) is None
    assert step.energy(flat)[0] == torch.inf and torch.isfinite(step.energy(flat)[1])


def test_the_full_model_has_it_too():
    body = ElasticBody(box_mesh((0.1, 0.1, 0.1), (1, 1, 1)), flow=Plasticine(3e3))
    step = body.flow_step(body.unflowed(), body.mesh.vertices, 0.01)
    assert step._response(body.deformation_gradient(1.1 * body.mesh.vertices)) is not None
