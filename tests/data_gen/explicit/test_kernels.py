"""The CUDA text, where no device is there to run it."""

import pytest
import torch

from data_gen.explicit.kernels import kernel_source


@pytest.mark.slow
@pytest.mark.parametrize("name", ["roll_out", "nearest", "resolve"])
@pytest.mark.filterwarnings("ignore")
def test_the_source_compiles_for_devices(name):
    from torch.cuda import _utils

    if torch.version.cuda is None:
        pytest.skip("torch without CUDA carries no NVRTC")
    binary, _ = _utils._nvrtc_compile(kernel_source(name), name, compute_capability="90")
    assert binary[:4] == b"\x7fELF" and name.encode() in binary
