"""CUDA texts: compiled without a device; launched by a stand-in for the driver, and on a device if there is one."""

import ctypes
import sys
from types import SimpleNamespace

import pytest
import torch

from physconvex.kernels import KernelUnavailable, cuda, launch, machine_code

SCALE = """
extern "C" __global__ void scale(float *x, int count, int by) {
    const int i = (blockIdx.y * gridDim.x + blockIdx.x) * blockDim.x + threadIdx.x;
    if (i < count) x[i] *= by;
}
"""


def test_a_text_becomes_machine_code_and_errors_are_told() -> None:
    pytest.importorskip("cuda.bindings")
    code = machine_code(SCALE, "sm_80")
    assert code[:4] == b"\x7fELF" and b"scale" in code
    with pytest.raises(KernelUnavailable, match=r"sm_80.*\n*.*error: "):
        machine_code("no CUDA", "sm_80")
    with pytest.raises(KernelUnavailable, match=r"sm_12345.*invalid"):
        machine_code(SCALE, "sm_12345")


def test_without_bindings_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    cuda._bindings.cache_clear()
    monkeypatch.setitem(sys.modules, "cuda.bindings.nvrtc", None)
    with pytest.raises(KernelUnavailable, match="pip install cuda-bindings"):
        machine_code(SCALE, "sm_80")


def test_arguments_are_packed_as_the_driver_reads_them(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[object] = []

    def launched(function: str, *given: int) -> tuple[int]:
        *shape, stream, places, _ = given
        slots = (ctypes.c_void_p * 3).from_address(places)
        address = ctypes.c_void_p.from_address(slots[0] or 0).value
        seen.extend(
            [function, shape, stream, address, *(ctypes.c_int.from_address(slot or 0).value for slot in slots[1:])]
        )
        return (0,)

    context: list[str] = []
    driver = SimpleNamespace(
        cuCtxPushCurrent=lambda one: (context.append(one), (0,))[1],
        cuCtxPopCurrent=lambda: (context.pop(), (0, None))[1],
        cuLaunchKernel=launched,
    )
    monkeypatch.setattr(cuda, "_bindings", lambda part: driver)
    monkeypatch.setattr(cuda, "_primary_context", lambda number: f"context {number}")
    monkeypatch.setattr(cuda, "_function", lambda source, name, number: f"{name} on {number}")
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: SimpleNamespace(cuda_stream=77))
    monkeypatch.setattr(cuda, "Tensor", _OnDevice)
    launch(SCALE, "scale", grid=(3, 2), threads=64, arguments=[_OnDevice(), 5, -7])  # type: ignore[list-item]
    assert seen == ["scale on 1", [3, 2, 1, 64, 1, 1, 0], 77, 0x7F0012345678, 5, -7] and not context
    driver.cuLaunchKernel = lambda *given: (719,)
    with pytest.raises(KernelUnavailable, match="launching scale failed: 719"):
        launch(SCALE, "scale", grid=(3, 2), threads=64, arguments=[_OnDevice(), 5, -7])  # type: ignore[list-item]
    assert not context


class _OnDevice:
    """What is asked of a tensor."""

    device = torch.device("cuda", 1)

    @staticmethod
    def data_ptr() -> int:
        return 0x7F0012345678


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_device_runs_the_text() -> None:
    x = torch.arange(100.0, device="cuda")
    launch(SCALE, "scale", grid=(1, 2), threads=64, arguments=[x, 90, 3])
    expected = torch.arange(100.0) * torch.where(torch.arange(100) < 90, 3, 1)
    assert torch.equal(x.cpu(), expected)
