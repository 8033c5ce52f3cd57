"""CUDA sources compiled by NVRTC and run on tensors, by NVIDIA's bindings, which torch's CUDA builds install.

Compilation needs only the bindings; launches need a device and are untested without one.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Literal

import torch
from torch import Tensor

from physconvex.kernels.build import KernelUnavailable


def launch(source: str, name: str, *, grid: tuple[int, int], threads: int, arguments: Sequence[Tensor | int]) -> None:
    """Run the kernel of that name in a source, compiled on first use for each device, on torch's stream.

    Args:
        source: the text.
        name: of the kernel, declared `extern "C"`.
        grid: blocks along two axes.
        threads: of each block.
        arguments: tensors of one CUDA device, passed as addresses, and numbers of the type int.

    Raises:
        KernelUnavailable: tensors that are not on a CUDA device, no bindings, or a source or device that they reject.
    """
    device = next(value.device for value in arguments if isinstance(value, Tensor))
    if device.type != "cuda":
        raise KernelUnavailable(f"the CUDA kernel was given tensors on {device}; move all of them to a CUDA device")
    driver, number = _bindings("driver"), torch.cuda.current_device() if device.index is None else device.index
    context, function = _primary_context(number), _function(source, name, number)
    slots = [
        ctypes.c_void_p(value.data_ptr()) if isinstance(value, Tensor) else ctypes.c_int(value) for value in arguments
    ]
    places = (ctypes.c_void_p * len(slots))(*map(ctypes.addressof, slots))
    stream = torch.cuda.current_stream(device).cuda_stream
    (error,) = driver.cuCtxPushCurrent(context)  # a new thread may have none
    _require(error, "entering the device's context")
    try:
        (error,) = driver.cuLaunchKernel(function, *grid, 1, threads, 1, 1, 0, stream, ctypes.addressof(places), 0)
    finally:
        driver.cuCtxPopCurrent()
    _require(error, f"launching {name}")


def machine_code(source: str, architecture: str) -> bytes:
    """A text compiled for an architecture such as "sm_90" (a cubin); needs no device.

    Raises:
        KernelUnavailable: no bindings, or a source or an architecture that NVRTC rejects; the message contains its log.
    """
    nvrtc = _bindings("nvrtc")
    error, program = nvrtc.nvrtcCreateProgram(source.encode(), b"kernel.cu", 0, None, None)
    _require(error, "NVRTC")
    options = [f"--gpu-architecture={architecture}".encode()]
    (failed,) = nvrtc.nvrtcCompileProgram(program, len(options), options)
    if int(failed):
        error, size = nvrtc.nvrtcGetProgramLogSize(program)
        log = b" " * size
        nvrtc.nvrtcGetProgramLog(program, log)
        nvrtc.nvrtcDestroyProgram(program)
        said = log.strip(b"\0 \n").decode(errors="replace")
        raise KernelUnavailable(f"NVRTC failed for {architecture} ({failed!s}): {said[-2000:]}")
    error, size = nvrtc.nvrtcGetCUBINSize(program)
    _require(error, "NVRTC")
    code = b" " * size
    (error,) = nvrtc.nvrtcGetCUBIN(program, code)
    nvrtc.nvrtcDestroyProgram(program)
    _require(error, "NVRTC")
    return code


@cache
def _function(source: str, name: str, device: int) -> object:
    """The kernel of that name, compiled for a device and loaded there."""
    driver = _bindings("driver")
    code = machine_code(source, "sm_{}{}".format(*torch.cuda.get_device_capability(device)))
    (error,) = driver.cuCtxPushCurrent(_primary_context(device))
    _require(error, "entering the device's context")
    try:
        error, module = driver.cuModuleLoadData(code)
        _require(error, f"loading {name}")
        error, function = driver.cuModuleGetFunction(module, name.encode())
        _require(error, f"finding {name}")
    finally:
        driver.cuCtxPopCurrent()
    return function


@cache
def _primary_context(device: int) -> object:
    """The context that torch uses on a device."""
    driver = _bindings("driver")
    error, handle = driver.cuDeviceGet(device)
    _require(error, f"finding device {device}")
    error, context = driver.cuDevicePrimaryCtxRetain(handle)
    _require(error, f"retaining the context of device {device}")
    return context


@cache
def _bindings(part: Literal["driver", "nvrtc"]) -> ModuleType:
    """Functions of the CUDA driver, or of NVRTC; both are loaded only here."""
    try:
        module = import_module(f"cuda.bindings.{part}")
        error, *_ = module.cuInit(0) if part == "driver" else module.nvrtcVersion()
    except (ImportError, RuntimeError) as failure:
        hint = "install a torch for CUDA, or: pip install cuda-bindings nvidia-cuda-nvrtc"
        raise KernelUnavailable(f"cuda.bindings.{part} cannot be used ({failure}); {hint}") from None
    _require(error, f"starting {part}")
    return module


def _require(error: int, doing: str) -> None:
    if int(error):
        raise KernelUnavailable(f"{doing} failed: {error!s}")
