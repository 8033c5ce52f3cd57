"""Where there is no compiler."""

from dataclasses import replace

import pytest
import torch

from physconvex import InputError
from physconvex.render import rasterize, render
from tests.convex.fields import random_field
from tests.convex.scenes import camera


def test_without_a_compiler_the_reference_draws_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    field = random_field(3, dtype=torch.float32)
    plain = render(field, camera(), backend="reference")
    monkeypatch.setattr(rasterize, "RENDER_KERNEL", replace(rasterize.RENDER_KERNEL))  # not yet loaded
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("PATH", "")
    with pytest.warns(RuntimeWarning, match=r"plain torch, which is slow: no C\+\+ compiler"):
        drawn = render(field, camera())
    assert torch.equal(drawn.colour, plain.colour)


@pytest.mark.wrong_types
def test_unknown_backends_are_refused() -> None:
    with pytest.raises(InputError, match="backend: got 'metal'"):
        render(random_field(2), camera(), backend="metal")
