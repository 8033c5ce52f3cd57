"""Where there is no compiler."""

from pathlib import Path

import pytest
import torch

from physconvex import InputError
from physconvex.render import native, rasterize, render
from tests.convex.fields import random_field
from tests.convex.scenes import camera


def test_without_a_compiler_the_reference_draws_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise native.KernelUnavailable("no C++ compiler found")

    field = random_field(3, dtype=torch.float32)
    plain = render(field, camera(), backend="reference")
    monkeypatch.setattr(rasterize, "load_library", refuse)
    with pytest.warns(RuntimeWarning, match=r"plain torch, which is slow: no C\+\+ compiler"):
        drawn = render(field, camera())
    assert torch.equal(drawn.colour, plain.colour)


def test_no_compiler_a_failing_one_and_an_unwritable_cache_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PHYSCONVEX_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CXX", "false")
    with pytest.raises(native.KernelUnavailable, match="false failed"):
        native.compiled(native.SOURCES)
    monkeypatch.setenv("PHYSCONVEX_CACHE", str(Path(__file__) / "cache"))
    with pytest.raises(native.KernelUnavailable, match="cannot be written"):
        native.compiled(native.SOURCES)
    monkeypatch.delenv("CXX")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(native.KernelUnavailable, match="no C\\+\\+ compiler found"):
        native.compiled(native.SOURCES)


@pytest.mark.slow
def test_compiled_once_then_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PHYSCONVEX_CACHE", str(tmp_path))
    library = native.compiled(native.SOURCES)
    monkeypatch.setattr(native, "_run", lambda command: pytest.fail("compiled again"))
    assert native.compiled(native.SOURCES) == library and [library] == list(tmp_path.iterdir())


@pytest.mark.wrong_types
def test_unknown_backends_are_refused() -> None:
    with pytest.raises(InputError, match="backend: got 'metal'"):
        render(random_field(2), camera(), backend="metal")
