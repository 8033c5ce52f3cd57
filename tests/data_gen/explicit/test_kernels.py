"""The CUDA text, where no device is there to run it."""

import pytest

from data_gen.explicit.kernels import kernel_source
from physconvex.kernels import machine_code


@pytest.mark.slow
@pytest.mark.parametrize("name", ["roll_out", "nearest", "resolve"])
def test_the_source_compiles_for_devices(name):
    pytest.importorskip("cuda.bindings")
    code = machine_code(kernel_source(name), "sm_90")
    assert code[:4] == b"\x7fELF" and name.encode() in code
