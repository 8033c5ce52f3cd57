"""The command line: what it prints where, and its exit codes."""

import csv
import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from inference.commands import predict_command
from physconvex import InputError
from tests.inference.conftest import MakeClip
from tests.inference.predictor_double import PredictorDouble


@pytest.fixture
def app(monkeypatch: pytest.MonkeyPatch) -> typer.Typer:
    """The command with a predictor double in place of the default checkpoint."""
    monkeypatch.setattr("inference.batch.load_predictor", lambda checkpoint, device: PredictorDouble())
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(predict_command)
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


def test_a_file_cut_short_is_predicted_named_and_makes_the_exit_code_1(
    app: typer.Typer, tmp_path: Path, make_clip: MakeClip
) -> None:
    make_clip(tmp_path / "clips" / "a.mp4")
    cut = make_clip(tmp_path / "clips" / "cut.mp4", frames=24)
    content = cut.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat"), "the index comes first, so that frames can be read"
    cut.write_bytes(content[: int(len(content) * 0.8)])
    for options in ((), (), ("--json",)):  # the later runs report what the first finished
        result = run(app, tmp_path / "clips", "--out", tmp_path / "out", "--no-progress", *options)
        assert result.exit_code == 1
        (line,) = result.stderr.splitlines()
        assert line.startswith(f"physconvex predict: {cut}: the file is cut short") and "of 24 frames decoded" in line
    said = line.removeprefix("physconvex predict: ")
    records = {Path(record["path"]).name: record for record in map(json.loads, result.stdout.splitlines())}
    assert records["cut.mp4"]["truncated"] == said and said in records["cut.mp4"]["warnings"]
    assert records["cut.mp4"]["youngs_modulus"] > 0 and records["a.mp4"]["truncated"] == ""
    with open(tmp_path / "out" / "predictions.csv", newline="", encoding="utf-8") as file:
        rows = {Path(row["path"]).name: row for row in csv.DictReader(file)}
    assert rows["cut.mp4"]["truncated"] == said and said in rows["cut.mp4"]["warnings"].split("; ")
    assert rows["cut.mp4"]["error"] == "" == rows["a.mp4"]["truncated"]


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
