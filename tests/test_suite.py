"""The suite's own devices: the guards on torch's global settings and on the scheduling class, and `--typecheck`."""

import os
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import torch


@pytest.fixture
def conftest(pytestconfig: pytest.Config) -> ModuleType:
    path = str(Path(__file__).with_name("conftest.py"))
    return next(p for p in pytestconfig.pluginmanager.get_plugins() if getattr(p, "__file__", None) == path)


@pytest.fixture
def kept(conftest: ModuleType) -> AbstractContextManager[None]:
    return conftest.torch_settings_kept()


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


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no scheduling classes here")
def test_another_scheduling_class_fails_and_is_put_back(conftest: ModuleType) -> None:
    """Batch class stands for the real-time one, which only the superuser may take."""
    before = os.sched_getscheduler(0)
    with pytest.raises(pytest.fail.Exception, match="scheduling class"), conftest.ordinary_priority():
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    assert os.sched_getscheduler(0) == before


@pytest.mark.wrong_types  # stand-ins for pytest's objects
def test_files_with_most_slow_tests_are_run_first(conftest: ModuleType) -> None:
    """Processes take whole files in this order: a long one that is begun last would leave the others idle."""

    def item(path: str, number: int, mark: str | None) -> SimpleNamespace:
        return SimpleNamespace(path=path, number=number, get_closest_marker=lambda name: name == mark or None)

    items = [item("a", 0, None), item("b", 1, "slow"), item("b", 2, None), item("c", 3, "slow"), item("c", 4, "slow")]
    conftest.pytest_collection_modifyitems(SimpleNamespace(getoption=lambda name: False), items)
    assert [i.number for i in items] == [3, 4, 1, 2, 0]


def typechecked(folder: Path, *statements: str) -> subprocess.CompletedProcess[str]:
    """Run a test of these statements under `--typecheck`."""
    root = Path(__file__).parents[1]
    test = folder / "test_one.py"
    test.write_text("\n    ".join(["def test_one():", *statements]) + "\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--typecheck"]
    command += ["--rootdir", str(root), "-c", str(root / "pyproject.toml"), "--confcutdir", str(root)]
    command += ["-p", "tests.conftest", str(test)]
    return subprocess.run(command, cwd=root, capture_output=True, text=True)


@pytest.mark.slow
def test_typecheck_takes_whole_numbers_and_refuses_wrong_shapes(tmp_path: Path) -> None:
    fine = [
        "from physconvex.fem import Scene, ElasticBody",
        "from physconvex.mesh import box_mesh",
        "Scene(ElasticBody(box_mesh((1, 1, 1), (1, 1, 1))))",
    ]
    assert typechecked(tmp_path, *fine).returncode == 0
    wrong = [
        "import numpy",
        "from physconvex.mesh.elements import shape_values",
        "shape_values(numpy.zeros((3, 5)), 1)",
    ]
    refused = typechecked(tmp_path, *wrong)
    assert refused.returncode == 1 and "TypeCheckError" in refused.stdout
