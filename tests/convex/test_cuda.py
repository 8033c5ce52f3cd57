"""The CUDA kernel: in emulation on the CPU against the reference, through NVRTC, and on a device where there is one."""

import ctypes
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import torch
from torch import Tensor

from physconvex.render import KernelUnavailable, View, cuda, render
from tests.convex.agreement import assert_agrees
from tests.convex.composites import compare_composites, polygons, rounding
from tests.convex.fields import random_field
from tests.convex.scenes import camera, hard_case

EMULATION = Path(__file__).with_name("gpu_emulation")


def test_tensors_of_the_cpu_are_refused() -> None:  # first: the fixture below stands in for a device from then on
    with pytest.raises(KernelUnavailable, match="tensors on cpu"):
        render(random_field(2, dtype=torch.float32), camera(), backend="cuda")


@pytest.fixture(scope="module")
def emulated(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The kernel's text compiled for the CPU takes the place of the device."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("needs g++")
    library = tmp_path_factory.mktemp("emulation") / "kernel.so"
    command = [compiler, "-std=c++20", "-O1", "-fPIC", "-shared", "-pthread", f"-I{cuda.SOURCE.parent}"]
    subprocess.run([*command, str(EMULATION / "kernel.cpp"), "-o", str(library)], check=True)
    loaded = ctypes.CDLL(str(library))

    def launch(name: str, grid: tuple[int, int], arguments: Sequence[Tensor | int]) -> None:
        plain = [ctypes.c_void_p(a.data_ptr()) if isinstance(a, Tensor) else ctypes.c_int(a) for a in arguments]
        getattr(loaded, f"run_{name}")(*map(ctypes.c_int, grid), *plain)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cuda, "_launch", launch)
        yield


def compare(field, width: int, height: int) -> None:
    """Image and gradients."""
    splats, inputs = polygons(field, width, height)
    compare_composites(splats, inputs, cuda.composite_cuda, rounding(splats, inputs))


@pytest.mark.slow
@pytest.mark.parametrize(("points", "count"), [(4, 20), (6, 300), (12, 20)])
def test_emulated_kernel_agrees_with_the_reference(emulated: None, points: int, count: int) -> None:
    compare(random_field(count, points=points), 37, 21)  # 300: more than one round of 256 candidates


@pytest.mark.slow
@pytest.mark.parametrize("case", ["edge_on", "opaque", "faint", "behind"])
def test_emulated_kernel_agrees_on_hard_scenes(emulated: None, case: str) -> None:
    compare(hard_case(case), 17, 16)


@pytest.mark.slow
@pytest.mark.parametrize("architecture", ["80", "90"])
@pytest.mark.filterwarnings("ignore")
def test_the_source_compiles_for_devices(architecture: str) -> None:
    from torch.cuda import _utils

    if torch.version.cuda is None:
        pytest.skip("torch without CUDA carries no NVRTC")
    for name in ("blend", "gradient"):
        binary, _ = _utils._nvrtc_compile(cuda.SOURCE.read_text(), name, compute_capability=architecture)
        assert binary[:4] == b"\x7fELF" and name.encode() in binary


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_device_draws_what_the_reference_does() -> None:
    field = random_field(400, dtype=torch.float32)
    view = View.of(camera(61, 45))
    leaves = [field.to(place).map(lambda t: t.clone().requires_grad_()) for place in ("cpu", "cuda")]
    images = [
        render(leaves[0], view, backend="reference"),
        render(leaves[1], view.to("cuda"), backend="cuda"),
    ]
    assert_agrees(images[1].colour.cpu(), images[0].colour, relative=1e-4, name="colour")
    for image in images:
        image.colour.square().sum().backward()
    for one, other in zip(leaves[1].tensors(), leaves[0].tensors(), strict=True):
        assert one.grad is not None and other.grad is not None
        assert_agrees(one.grad.cpu(), other.grad, relative=1e-3)
