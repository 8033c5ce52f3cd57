"""bf16 where the processor computes in it."""

from pathlib import Path

import pytest
import torch

from train import optimisation
from train.optimisation import precision_for


@pytest.mark.parametrize(("known", "expected"), [(True, "bf16"), (False, "no")])
def test_a_processor_that_would_emulate_bf16_computes_in_float32(monkeypatch, recwarn, known, expected):
    monkeypatch.setattr(optimisation, "_processor_knows_bf16", lambda: known)
    if known:
        assert precision_for("bf16", cpu=True) == "bf16"
    else:
        with pytest.warns(RuntimeWarning, match="does not compute in bf16"):
            assert precision_for("bf16", cpu=True) == expected
    assert precision_for("no", cpu=True) == "no"


def test_an_accelerator_computes_in_bf16(monkeypatch):
    monkeypatch.setattr(optimisation, "_processor_knows_bf16", lambda: False)
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: True)
    assert precision_for("bf16", cpu=False) == "bf16"


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="needs Linux")
def test_the_processor_is_asked():
    flags = Path("/proc/cpuinfo").read_text().split()
    if "avx2" in flags:
        assert optimisation._processor_knows_bf16() == ("avx512_bf16" in flags or "amx_bf16" in flags)
