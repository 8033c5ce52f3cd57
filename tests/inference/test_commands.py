"""The command line: what it prints where, and its exit codes."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from inference.commands import predict
from physconvex.errors import InputError
from tests.inference.conftest import MakeClip
from tests.inference.predictor_double import PredictorDouble


@pytest.fixture
def app(monkeypatch: pytest.MonkeyPatch) -> typer.Typer:
    """The command with a predictor double in place of the default checkpoint."""
    monkeypatch.setattr("inference.batch.load_predictor", lambda checkpoint, device: PredictorDouble())
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(predict)
    return app


def run(app: typer.Typer, *arguments: object) -> object:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_table_and_where_the_results_are(app: typer.Typer, tmp_path: Path, make_clip: MakeClip) -> None:
    clip = make_clip(tmp_path / "a.mp4")
    result = run(app, clip, "--out", tmp_path / "out", "--density", 500, "--object-size", 0.3)
    assert result.exit_code == 0, result.output
    assert "kPa" in result.stdout and "1 predicted" in result.stdout
    assert str(tmp_path / "out" / "predictions.csv") in result.stdout
    assert result.stderr == ""
    assert (tmp_path / "out" / "gallery.html").read_text().startswith("<!doctype html>")


def test_json_lines_alone_on_stdout_and_errors_on_stderr(app: typer.Typer, tmp_path: Path, make_clip: MakeClip) -> None:
    make_clip(tmp_path / "clips" / "a.mp4")
    (tmp_path / "clips" / "empty.mp4").touch()
    for _ in range(2):  # the second run reports what the first finished
        result = run(app, tmp_path / "clips", "--out", tmp_path / "out", "--json", "--no-progress")
        assert result.exit_code == 1
        lines = [json.loads(line) for line in result.stdout.splitlines()]
        by_name = {Path(line["path"]).name: line for line in lines}
        assert set(by_name) == {"a.mp4", "empty.mp4"}
        assert by_name["a.mp4"]["error"] == "" and by_name["a.mp4"]["youngs_modulus"] > 0
        assert by_name["a.mp4"]["units"]["youngs_modulus"] == "Pa"
        (line,) = result.stderr.splitlines()
        assert line.startswith("physconvex predict: ") and "empty.mp4" in line


def test_missing_paths_fail_and_the_others_go_on(app: typer.Typer, tmp_path: Path, make_clip: MakeClip) -> None:
    clip = make_clip(tmp_path / "a.mp4")
    result = run(app, tmp_path / "none.mp4", clip, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "none.mp4: does not exist" in result.stderr and "1 predicted" in result.stdout


def test_a_folder_without_clips_fails(app: typer.Typer, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    result = run(app, tmp_path / "empty", "--out", tmp_path / "out")
    assert result.exit_code == 1 and "no video" in result.stderr


def test_wrong_usage(app: typer.Typer, tmp_path: Path, make_clip: MakeClip) -> None:
    assert run(app).exit_code == 2
    assert run(app, tmp_path, "--fps", "quick").exit_code == 2
    result = run(app, make_clip(tmp_path / "a.mp4"), "--out", tmp_path / "out", "--fps", "-3")
    assert isinstance(result.exception, InputError), "the console script turns it into exit code 2"


def test_help_names_every_option(app: typer.Typer) -> None:
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).stdout
    for option in (
        "--out --fps --density --object-size --checkpoint --device --batch-size --workers --json --redo --no-progress"
    ).split():
        assert option in text
