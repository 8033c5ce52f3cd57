"""`physconvex generate`: what it lists, what it refuses."""

import pytest
import trimesh
from typer.testing import CliRunner

from data_gen.commands import app
from physconvex import InputError
from physconvex.cli import main


def test_help_lists_the_commands_and_their_options():
    assert {"dataset", "captures"} <= set(CliRunner().invoke(app, ["--help"]).output.split())
    for command, options in (("dataset", {"--workers", "--engine", "--objects"}), ("captures", {"--markers", "--set"})):
        result = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"})
        assert result.exit_code == 0
        assert {"--out", "--count", "--config", "--seed"} | options <= set(result.output.split())


def test_the_console_script_knows_generate(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["generate", "--help"])
    assert stop.value.code == 0
    assert "captures" in capsys.readouterr().out


def test_bad_input_is_one_line_and_exit_code_2(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["generate", "dataset", "--out", str(tmp_path / "d"), "--config", "absent", "--no-progress"])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert "absent" in error and "training" in error and error.count("\n") == 1
    assert not (tmp_path / "d").exists()


def test_settings_override_the_preset_and_are_checked(tmp_path):
    result = CliRunner().invoke(app, ["dataset", "--out", str(tmp_path), "--set", "video.fps=-1", "--no-progress"])
    assert isinstance(result.exception, InputError)
    assert "video.fps" in str(result.exception)


@pytest.mark.parametrize("command", ["dataset", "captures"])
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--objects", "nowhere"], "nowhere is not a folder"),
        (["--objects", "{empty}"], "no mesh in"),
        (["--set", "material.law=rubber"], "got 'rubber'; expected one of neo_hookean"),
    ],
)
def test_what_no_simulation_could_use_is_refused_before_anything_is_written(tmp_path, command, options, told):
    (tmp_path / "empty").mkdir()
    out, given = tmp_path / "out", [option.format(empty=tmp_path / "empty") for option in options]
    result = CliRunner().invoke(app, [command, "--out", str(out), "--no-progress", *given])
    assert isinstance(result.exception, InputError) and told in str(result.exception)
    assert not out.exists()


def test_falls_and_benchmarks_refuse_at_once_what_they_cannot_use(tmp_path):
    (tmp_path / "objects" / "ball").mkdir(parents=True)
    trimesh.creation.icosphere().export(tmp_path / "objects" / "ball" / "ball.stl")  # without colours
    out = ["--out", str(tmp_path / "out"), "--no-progress"]
    for arguments, told in (
        (["falls", "--set", "video.fps=30"], "expected (0.0, 0.0, -9.81), 24.0"),
        (["benchmark", "--objects", str(tmp_path / "objects"), "--count", "1"], "colors"),
        (["benchmark", "--objects", str(tmp_path / "objects"), "--name", "cube"], "['cube'] are not in"),
        (["benchmark", "--objects", str(tmp_path / "objects"), "--count", "1", "--only", "cube"], "cube: not in the"),
    ):
        result = CliRunner().invoke(app, [*arguments, *out])
        assert isinstance(result.exception, InputError) and told in str(result.exception), result.exception
        assert not (tmp_path / "out").exists()
