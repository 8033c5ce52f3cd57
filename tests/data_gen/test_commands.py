"""`physconvex generate`: what it lists, what it refuses."""

import pytest
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
