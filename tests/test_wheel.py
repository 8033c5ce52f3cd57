"""The wheel carries every package and its data, and runs from another folder."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("physconvex", "models", "data_gen", "train", "inference")

pytestmark = pytest.mark.slow


def _run(*command: str | Path, cwd: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built, without a network, from a copy of the sources."""
    source = tmp_path_factory.mktemp("source")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    out = tmp_path_factory.mktemp("wheel")
    _run(
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(out),
        str(source),
        cwd=source,
    )
    return next(out.glob("*.whl"))


def test_wheel_holds_exactly_the_packages_and_their_data(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == set(PACKAGES)
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    assert {"physconvex/__init__.pyi", "inference/templates/gallery.html"} <= set(names)
    for package in PACKAGES:
        sources = {
            str(path.relative_to(ROOT))
            for path in (ROOT / package).rglob("*")
            if path.suffix in (".py", ".pyi", ".yaml", ".html", ".cpp", ".cu", ".h") or path.name == "py.typed"
        }
        assert sources <= set(names)
    checkpoints = [p for p in (ROOT / "models" / "checkpoints").rglob("*") if p.is_file()]
    assert {str(path.relative_to(ROOT)) for path in checkpoints} <= set(names)


def test_installed_wheel_runs_from_another_folder(wheel: Path, tmp_path: Path) -> None:
    """The fresh environment holds the wheel alone; the dependencies come in from this one by a path file."""
    home = tmp_path / "environment"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    site = Path(_run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip())
    _run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        str(python),
        "install",
        "--no-deps",
        "--no-index",
        wheel,
        cwd=tmp_path,
    )
    # The finder of an editable install is a path file in the other environment, which this line does not run.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for package in PACKAGES:
        origin = _run(python, "-c", f"import {package}; print({package}.__file__)", cwd=elsewhere).strip()
        assert Path(origin).is_relative_to(site)
    assert "predict" in _run(home / "bin" / "physconvex", "--help", cwd=elsewhere)
    for command in ("predict", "generate", "train", "evaluate"):
        assert "Usage: physconvex" in _run(home / "bin" / "physconvex", command, "--help", cwd=elsewhere)
