"""Stretches and their axes: by FᵀF where that is exact enough, by singular values else."""

import pytest
import torch

from physconvex.materials import StandardLinearSolid, inelastic, principal_strains
from physconvex.materials.principal_strains import PrincipalFrame, singular_values
from tests.kernels.missing import MISSING


@pytest.fixture(params=["compiled", "torch"])
def kind(request, monkeypatch):
    """Both arithmetics; without a compiler torch's is taken."""

    if request.param == "torch":
        monkeypatch.setattr(principal_strains, "STRAIN_KERNEL", MISSING)
    return request.param


@pytest.mark.parametrize("thin", [1.0, 1e-1, 1e-3, 1e-9, 1e-14])
def test_frame_gives_back_the_gradient_however_flat_it_is(thin, kind):
    generator = torch.Generator().manual_seed(3)
    f = torch.eye(3, dtype=torch.float64) + 0.2 * torch.randn(50, 3, 3, dtype=torch.float64, generator=generator)
    f[:, 2] *= thin
    found = singular_values(f)
    assert (found is not None) == (kind == "compiled" and thin > 1e-12)
    frame = PrincipalFrame.of(f)
    again = (frame.u * frame.stretches.unsqueeze(-2)) @ frame.vt
    torch.testing.assert_close(again, f, rtol=0, atol=1e-13)
    for axes in (frame.u, frame.vt):
        eye = torch.eye(3, dtype=torch.float64).expand_as(axes)
        torch.testing.assert_close(axes @ axes.mT, eye, rtol=0, atol=1e-10)
    torch.testing.assert_close(frame.stretches, torch.linalg.svdvals(f), rtol=1e-10, atol=1e-14)
    assert (frame.proper == (torch.linalg.det(f) > 0)).all() and frame.proper.any()


def test_equal_stretches_and_what_is_not_finite():
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)))[0]
    frame = PrincipalFrame.of(torch.stack([torch.eye(3, dtype=torch.float64), 2 * turn]))
    torch.testing.assert_close(frame.stretches, torch.tensor([[1.0] * 3, [2.0] * 3], dtype=torch.float64))
    torch.testing.assert_close(frame.u[1] @ frame.vt[1], turn)
    assert singular_values(torch.full((1, 3, 3), torch.nan, dtype=torch.float64)) is None
    assert singular_values(torch.eye(3).expand(2, 3, 3)) is None  # single precision


def test_a_body_turned_inside_out_is_not_proper():
    f = torch.diag(torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64))
    assert not bool(PrincipalFrame.of(f).proper)


def _told(taken, found):
    taken.append("compiled")
    return found


def test_energy_and_stress_at_one_gradient_take_the_stretches_once(kind, monkeypatch):
    taken = []
    of, respond = PrincipalFrame.of, inelastic.flow_response
    monkeypatch.setattr(PrincipalFrame, "of", classmethod(lambda cls, f: taken.append("torch") or of(f)))
    monkeypatch.setattr(
        inelastic, "flow_response", lambda *given, **more: (found := respond(*given, **more)) and _told(taken, found)
    )
    eye = torch.eye(3, dtype=torch.float64).expand(4, 3, 3)
    mu = torch.full((4,), 1e3, dtype=torch.float64)
    step = StandardLinearSolid(0.3, 0.1).during(eye, eye, mu, mu, 1e-3)
    for scale in (1.1, 1.2):
        f = scale * eye
        step.energy(f)
        step.stress(f)
    assert taken == [kind] * 2
    fresh = StandardLinearSolid(0.3, 0.1).during(eye, eye, mu, mu, 1e-3)
    torch.testing.assert_close(step.stress(1.1 * eye), fresh.stress(1.1 * eye))
