"""Which arithmetic a run computes in."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, Literal

import torch

Precision = Literal["no", "bf16"]


def precision_for(wanted: Precision, *, cpu: bool) -> Precision:
    """`wanted`, but "no" (with a warning) for bf16 on a processor that only emulates it, many times slower.

    Args:
        wanted: of the configuration.
        cpu: no accelerator is to be used.
    """
    if wanted == "no" or not (cpu or not torch.accelerator.is_available()) or _processor_knows_bf16():
        return wanted
    warnings.warn(
        "mixed_precision: this processor does not compute in bf16; the run is in float32", RuntimeWarning, stacklevel=2
    )
    return "no"


def _processor_knows_bf16() -> bool:
    asked = getattr(torch.cpu, "get_capabilities", dict)  # an old torch lacks it: better slow than very slow
    capabilities: Mapping[str, Any] = asked()
    return any(capabilities.get(name, False) for name in ("avx512_bf16", "amx_bf16", "bf16"))
