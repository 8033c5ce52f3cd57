"""The suite's own guard on torch's global settings."""

from contextlib import AbstractContextManager
from pathlib import Path

import pytest
import torch


@pytest.fixture
def kept(pytestconfig: pytest.Config) -> AbstractContextManager[None]:
    conftest = str(Path(__file__).with_name("conftest.py"))
    plugins = pytestconfig.pluginmanager.get_plugins()
    return next(p for p in plugins if getattr(p, "__file__", None) == conftest).torch_settings_kept()


def test_changed_settings_fail_and_are_put_back(kept: AbstractContextManager[None]) -> None:
    threads, dtype = torch.get_num_threads(), torch.get_default_dtype()
    with pytest.raises(AssertionError, match=r"'number of threads'"), kept:
        torch.set_num_threads(threads + 1)
        torch.set_default_dtype(torch.float64)
        torch.use_deterministic_algorithms(True)
    assert (torch.get_num_threads(), torch.get_default_dtype()) == (threads, dtype)
    assert not torch.are_deterministic_algorithms_enabled()


def test_unchanged_settings_are_not_written(
    kept: AbstractContextManager[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`use_deterministic_algorithms` loads torch's compiler, seconds in every run of the suite."""
    written = []
    monkeypatch.setattr(torch, "use_deterministic_algorithms", written.append)
    with kept:
        pass
    assert not written
