"""What every test gets: fixed seeds, a guard on global state, and, with `--typecheck`, checked shapes."""

import os
import random
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from types import ModuleType

import numpy as np
import pytest

PACKAGES = ("physconvex", "models", "data_gen", "train", "inference")
HAS_COMPILER = any(map(shutil.which, filter(None, (os.environ.get("CXX"), "c++", "g++", "clang++"))))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--typecheck",
        action="store_true",
        help="check annotations and jaxtyping shapes at run time (beartype)",
    )


def pytest_configure(config: pytest.Config) -> None:
    if not HAS_COMPILER:
        config.addinivalue_line("filterwarnings", "ignore:.*plain torch, which is slow:RuntimeWarning")
    if config.getoption("--typecheck"):
        from beartype import BeartypeConf, beartype
        from jaxtyping import install_import_hook

        loaded = [name for name in PACKAGES if name in sys.modules]
        assert not loaded, f"--typecheck comes too late for {loaded}"
        # int counts as float (PEP 484). The hook wants a name to import, and pytest imports this file under its own.
        checker = ModuleType("runtime_types")
        checker.__dict__["check"] = beartype(conf=BeartypeConf(is_pep484_tower=True))
        sys.modules[checker.__name__] = checker
        install_import_hook(PACKAGES, "runtime_types.check")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--typecheck"):
        for item in items:
            if item.get_closest_marker("wrong_types"):
                item.add_marker(pytest.mark.skip(reason="passes a wrong type on purpose, which the checker refuses"))
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])  # a long file that is begun last leaves the other processes idle
    marked = [item for item in items if item.get_closest_marker("gpu")]
    if marked:
        import torch

        if not torch.cuda.is_available():
            for item in marked:
                item.add_marker(pytest.mark.skip(reason="needs a CUDA device"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, object, object]:
    return (yield from _skipped_without_a_compiler())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    return (yield from _skipped_without_a_compiler())


def _skipped_without_a_compiler() -> Generator[None, object, object]:
    """Tests of compiled kernels need a compiler; the packages are not imported here."""
    try:
        return (yield)
    except RuntimeError as error:
        if HAS_COMPILER or type(error).__name__ != "KernelUnavailable":
            raise
        pytest.skip("needs a C++ compiler")


@pytest.fixture(autouse=True)
def _fixed_seeds() -> None:
    """Start each test from the same global random state: network weights are drawn from torch's."""
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 (libraries below us draw from it)
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(0)


def _torch_settings() -> dict[str, object]:
    torch = sys.modules["torch"]
    return {
        "default dtype": torch.get_default_dtype(),
        "default device": torch.get_default_device(),
        "gradient mode": torch.is_grad_enabled(),
        "number of threads": torch.get_num_threads(),
        "deterministic algorithms": torch.are_deterministic_algorithms_enabled(),
    }


@contextmanager
def torch_settings_kept() -> Iterator[None]:
    """Fail if torch's global settings are left other than they were found, and put back those that changed.

    A setting that did not change is not written: `use_deterministic_algorithms` alone loads half of torch.
    """
    torch = sys.modules["torch"]
    put_back: dict[str, Callable[..., object]] = {
        "default dtype": torch.set_default_dtype,
        "default device": torch.set_default_device,
        "gradient mode": torch.set_grad_enabled,
        "number of threads": torch.set_num_threads,
        "deterministic algorithms": torch.use_deterministic_algorithms,
    }
    before = _torch_settings()
    yield
    after = _torch_settings()
    changed = {name: (before[name], after[name]) for name in before if before[name] != after[name]}
    for name in changed:
        put_back[name](before[name])
    assert not changed, f"the test changed torch's global settings (before, after): {changed}"


@contextmanager
def ordinary_priority() -> Iterator[None]:
    """Fail if the process is left in another scheduling class than it was found in, and put it back.

    Under the superuser some libraries make the thread that calls them a real-time one (SVT-AV1's encoder does), which
    then lets no other process have its core.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    yield
    after = os.sched_getscheduler(0)
    if after != before[0]:
        os.sched_setscheduler(0, *before)
        pytest.fail(f"the test changed the scheduling class of the process (before, after): {before[0]}, {after}")


@pytest.fixture(autouse=True)
def _priority_stays() -> Iterator[None]:
    """Fail a test that takes the machine from all others."""
    if not hasattr(os, "sched_getscheduler"):  # Linux has it
        yield
        return
    with ordinary_priority():
        yield


@pytest.fixture(autouse=True)
def _torch_settings_stay() -> Iterator[None]:
    """Fail a test that changes torch's global settings."""
    if "torch" not in sys.modules:
        yield
        return
    with torch_settings_kept():
        yield
