"""The CUDA kernel: in emulation on the CPU against the reference, through NVRTC, and on a device where there is one."""

import ctypes
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad

from physconvex.convex import ConvexField
from physconvex.kernels import SOURCES, KernelUnavailable, machine_code
from physconvex.render import Splats, View, cuda, render, render_jacobian
from physconvex.render.directions import load_forward_mode
from physconvex.render.hull import planar_hulls
from tests.convex.agreement import assert_agrees
from tests.convex.composites import compare_composites, compare_tangents, layers, polygons, rounding
from tests.convex.fields import random_field
from tests.convex.scenes import HARD_CASES, camera, hard_case

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
    command = [compiler, "-std=c++20", "-O1", "-fPIC", "-shared", "-pthread", f"-I{SOURCES / 'render_cuda'}"]
    subprocess.run([*command, str(EMULATION / "kernel.cpp"), "-o", str(library)], check=True)
    loaded = ctypes.CDLL(str(library))

    def launch(name: str, grid: tuple[int, int], arguments: Sequence[Tensor | int]) -> None:
        plain = [ctypes.c_void_p(a.data_ptr()) if isinstance(a, Tensor) else ctypes.c_int(a) for a in arguments]
        getattr(loaded, f"run_{name}")(*map(ctypes.c_int, grid), *plain)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cuda, "_launch", launch)
        yield


def compare(field, width: int, height: int) -> None:
    """Image, gradients, derivatives in more directions than one launch takes."""
    splats, inputs = polygons(field, width, height)
    tolerance = rounding(splats, inputs)
    compare_composites(splats, inputs, cuda.composite_cuda, tolerance)
    compare_tangents(splats, inputs, cuda.composite_tangents_cuda, tolerance, count=cuda.DIRECTIONS + 2)


@pytest.mark.slow
@pytest.mark.parametrize(("points", "count"), [(6, 300), *((points, 20) for points in range(4, 13) if points != 6)])
def test_emulated_kernel_agrees_with_the_reference(emulated: None, points: int, count: int) -> None:
    compare(random_field(count, points=points), 37, 21)  # 300: more than one round of 256 candidates


@pytest.mark.slow
@pytest.mark.parametrize("case", HARD_CASES)
def test_emulated_kernel_agrees_on_hard_scenes(emulated: None, case: str) -> None:
    compare(hard_case(case), 17, 16)


@pytest.mark.slow
def test_emulated_hulls_are_those_of_the_reference(emulated: None) -> None:
    points = torch.randn((600, 6, 2), generator=torch.Generator().manual_seed(3))
    points[:300] = (2 * points[:300]).round()  # many in line or equal
    found, expected = cuda.planar_hulls_cuda(points), planar_hulls(points)
    assert torch.equal(found.order, expected.order) and torch.equal(found.number, expected.number)
    torch.testing.assert_close(found.width, expected.width, rtol=1e-12, atol=1e-12)
    assert len(cuda.planar_hulls_cuda(points[:0]).number) == 0


@pytest.mark.slow
def test_jacobian_in_emulation(emulated: None) -> None:
    field, view = random_field(20, seed=9, size=0.1, dtype=torch.float32), View.of(camera(20, 14))

    def scene(p: Tensor) -> tuple[ConvexField, View]:
        return field.with_points(field.points * (1 + p[:3])), view.moved(p[3:])

    drawn = [render_jacobian(scene, torch.zeros(9), backend=backend) for backend in ("cuda", "kernel")]
    for name in ("colour", "alpha", "weighted_depth"):
        assert_agrees(*(getattr(one, name) for one in drawn), relative=1e-4, name=name)


@pytest.mark.slow
def test_forward_mode_of_the_torch_function_in_emulation(emulated: None) -> None:
    load_forward_mode()
    splats, inputs = polygons(random_field(6, seed=7))
    with forward_ad.dual_level():
        duals = tuple(forward_ad.make_dual(tensor, 1e-2 * tensor) for tensor in inputs)
        image = layers(splats, duals, cuda.composite_cuda)
        tangents = [forward_ad.unpack_dual(tensor).tangent for tensor in (image.features, image.transmittance)]
    plain = Splats(splats.convex, splats.starts, *inputs[1:])
    expected = cuda.composite_tangents_cuda(plain, inputs[0], [tuple(1e-2 * tensor for tensor in inputs)])
    assert all(torch.equal(tangent, some[0]) for tangent, some in zip(tangents, expected, strict=True))
    assert tangents[0].abs().max() > 0


@pytest.mark.slow
@pytest.mark.parametrize("architecture", ["sm_80", "sm_90"])
def test_the_source_compiles_for_devices(architecture: str) -> None:
    pytest.importorskip("cuda.bindings")
    for name in cuda.FUNCTIONS:
        code = machine_code(cuda.render_source(name), architecture)
        assert code[:4] == b"\x7fELF" and name.encode() in code


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
