"""The package's face, its command line and its layer contract."""

import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from typer.testing import CliRunner

import physconvex
from physconvex import ConvergenceError, InputError, cli

ROOT = Path(__file__).resolve().parent.parent


def _python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Entry points of a package made for the test: a function, a group, and one that cannot be imported."""
    package = tmp_path / "toyplugin"
    package.mkdir()
    (package / "__init__.py").write_text("raise_if_imported = 1\n")
    (package / "single.py").write_text(
        '"""Module line."""\n'
        "import typer\n"
        "from physconvex.errors import ConvergenceError, InputError\n"
        "def greet(name: str, loud: bool = False) -> None:\n"
        '    """Greet by name.\n\n    More words.\n    """\n'
        "    if name == 'bad':\n        raise InputError('name: got bad, expected good; say good')\n"
        "    if name == 'stuck':\n        raise ConvergenceError('no convergence')\n"
        "    if name == 'half':\n        raise typer.Exit(1)\n"
        "    print(name.upper() if loud else name)\n"
    )
    (package / "group.py").write_text(
        '"""Several things."""\n'
        "import typer\n"
        "app = typer.Typer()\n"
        "@app.command()\ndef first() -> None:\n    print('one')\n"
        "@app.command()\ndef second() -> None:\n    print('two')\n"
    )
    (package / "broken.py").write_text("import a_module_that_does_not_exist\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    values = {"greet": "single:greet", "several": "group:app", "broken": "broken:app"}
    points = [EntryPoint(name, f"toyplugin.{value}", cli.COMMAND_GROUP) for name, value in values.items()]
    monkeypatch.setattr(cli, "entry_points", lambda group: points)
    for name in [name for name in sys.modules if name.split(".")[0] == "toyplugin"]:
        monkeypatch.delitem(sys.modules, name)


def _main(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        cli.main(list(arguments))
    out, err = capsys.readouterr()
    return int(stop.value.code or 0), out, err


def test_import_is_light() -> None:
    result = _python("import sys, physconvex; print([m for m in ('torch', 'numpy', 'typer') if m in sys.modules])")
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


def test_face_lists_lazy_names_and_refuses_others() -> None:
    assert set(physconvex.__all__) <= set(dir(physconvex))
    assert physconvex.InputError is InputError
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = physconvex.nonsense


@pytest.mark.parametrize("name", sorted(physconvex._LAZY))
def test_lazy_name_resolves(name: str) -> None:
    value = getattr(physconvex, name)
    assert value.__name__ == physconvex._LAZY[name][1]
    assert value is getattr(physconvex, name)


def test_help_is_light_and_names_every_installed_command() -> None:
    code = (
        "import sys\nfrom physconvex.cli import main\n"
        "try:\n    main(['--help'])\n"
        "finally:\n    print([m for m in ('torch', 'models', 'inference', 'data_gen') if m in sys.modules])"
    )
    result = _python(code)
    assert result.stdout.rstrip().endswith("[]"), result.stdout + result.stderr
    for command in cli._commands():
        assert f"│ {command} " in result.stdout


@pytest.mark.parametrize("command", sorted(cli._commands()))
def test_installed_command_loads_and_has_help(command: str) -> None:
    loaded = cli._load(cli._commands()[command])
    assert loaded.name == command
    assert cli._short_help(cli._commands()[command])


def test_help_shows_units(capsys: pytest.CaptureFixture[str]) -> None:
    assert "[kg/m³]" in _main(capsys, "predict", "--help")[1]
    assert "[pixels]" in _main(capsys, "generate", "benchmark", "--help")[1]  # a command of a group


@pytest.mark.usefixtures("commands")
def test_help_reads_docstrings_without_importing(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = _main(capsys, "--help")
    assert code == 0
    assert "Greet by name." in out
    assert "Several things." in out
    assert "broken" in out
    assert "toyplugin" not in sys.modules


@pytest.mark.usefixtures("commands")
@pytest.mark.parametrize(
    ("arguments", "code", "out", "err"),
    [
        (["greet", "anna", "--loud"], 0, "ANNA\n", ""),
        (["greet", "half"], 1, "", ""),
        (["greet", "stuck"], 1, "", "physconvex: no convergence\n"),
        (["greet", "bad"], 2, "", "physconvex: name: got bad, expected good; say good\n"),
        (["several", "second"], 0, "two\n", ""),
    ],
)
def test_exit_codes(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, out: str, err: str) -> None:
    assert _main(capsys, *arguments) == (code, out, err)


@pytest.mark.usefixtures("commands")
@pytest.mark.parametrize("arguments", [["greet"], ["greet", "anna", "--nonsense"], ["nonsense"], ["--nonsense"]])
def test_wrong_usage_is_exit_code_2(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    code, out, err = _main(capsys, *arguments)
    assert (code, out) == (2, "")
    assert "Usage" in err


@pytest.mark.usefixtures("commands")
def test_broken_command_names_its_entry_point(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = _main(capsys, "broken")
    assert code == 1
    assert err.count("\n") == 1
    assert "'toyplugin.broken:app'" in err
    assert "a_module_that_does_not_exist" in err
    _, _, err = _main(capsys, "--traceback", "broken")
    assert "Traceback" in err


def test_version() -> None:
    result = CliRunner().invoke(cli.app, ["--version"])
    assert result.output == f"physconvex {physconvex.__version__}\n"


def test_errors_are_what_callers_catch() -> None:
    assert issubclass(InputError, ValueError)
    assert issubclass(ConvergenceError, RuntimeError)


def test_layer_contract_holds() -> None:
    program = Path(sys.executable).with_name("lint-imports")
    result = subprocess.run([program, "--no-cache"], capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
