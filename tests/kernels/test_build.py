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


def test_a_compiler_that_fails_is_tried_once(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    tried = []

    def fails(folder: Path, **_: object) -> Path:
        tried.append(folder)
        raise native.KernelUnavailable("it fails")

    monkeypatch.setattr(native, "compiled", fails)
    kernel = native.Kernel(folder, {})
    assert not kernel.available and not kernel.available
    with pytest.raises(native.KernelUnavailable, match="it fails"):
        _ = kernel.library
    assert tried == [folder]


def test_the_types_of_functions_are_declared(folder: Path) -> None:
    kernel = native.Kernel(folder, {"answer": (ctypes.c_int, [])})
    assert kernel.available and kernel.library.answer() == 42
    with pytest.raises(native.KernelUnavailable, match=r"holds no kernel\.cpp"):
        _ = native.Kernel(folder.parent, {}).library
