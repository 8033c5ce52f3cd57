"""C++ sources compiled on first use."""

import ctypes
from pathlib import Path

import pytest

from physconvex.kernels import build as native

SOURCE = 'extern "C" int answer() { return 42; }\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """One small source."""
    made = tmp_path / "source"
    made.mkdir()
    (made / "kernel.cpp").write_text(SOURCE)
    return made


def test_no_compiler_a_failing_one_and_an_unwritable_cache_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: Path
) -> None:
    monkeypatch.setenv("PHYSCONVEX_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CXX", "false")
    with pytest.raises(native.KernelUnavailable, match="false failed"):
        native.compiled(folder)
    monkeypatch.setenv("PHYSCONVEX_CACHE", str(Path(__file__) / "cache"))
    with pytest.raises(native.KernelUnavailable, match="cannot be written"):
        native.compiled(folder)
    monkeypatch.delenv("CXX")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(native.KernelUnavailable, match="no C\\+\\+ compiler found"):
        native.compiled(folder)


def test_compiled_once_then_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: Path) -> None:
    monkeypatch.setenv("PHYSCONVEX_CACHE", str(tmp_path / "cache"))
    library = native.compiled(folder)
    assert ctypes.CDLL(str(library)).answer() == 42
    other = native.compiled(folder, flags=(*native.FLAGS, "-DOTHER"))
    monkeypatch.setattr(native, "_run", lambda command: pytest.fail("compiled again"))
    assert native.compiled(folder) == library != other
    assert {library, other} == set((tmp_path / "cache").iterdir())


def test_a_compiler_that_fails_is_tried_once() -> None:
    tried = []

    def load() -> ctypes.CDLL:
        tried.append(1)
        raise native.KernelUnavailable("it fails")

    assert not native.available(load) and not native.available(load)
    assert len(tried) == 1
