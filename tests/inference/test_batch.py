"""Batches: streaming, result files, resuming, kills."""

import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pyarrow.parquet
import pytest

from inference import ClipSource, iter_predictions, predict, predict_batch
from inference.background_reader import BackgroundReader, Failure
from inference.table import ResultRow
from physconvex import InputError
from tests.inference.conftest import MakeClip
from tests.inference.predictor_double import PredictorDouble

COLUMNS = [
    "path",
    "youngs_modulus",
    "poisson_ratio",
    "log10_youngs_modulus_std",
    "poisson_ratio_std",
    "error",
]


def table(out: Path) -> list[dict[str, str]]:
    with open(out / "predictions.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def folder(tmp_path: Path, make_clip: MakeClip) -> Path:
    """Five clips of different size, length and rate in nested folders, two of one name."""
    clips = tmp_path / "clips"
    make_clip(clips / "a.mp4")
    make_clip(clips / "wide.mp4", width=96, height=48, frames=9)
    make_clip(clips / "sub" / "a.mp4", fps=48, frames=24)
    make_clip(clips / "sub" / "deep" / "tall.mp4", width=40, height=120)
    make_clip(clips / "short.mp4", frames=5)
    return clips


@pytest.mark.parametrize("processes", [False, True])
def test_every_clip_gets_its_row_and_files(tmp_path: Path, folder: Path, processes: bool) -> None:
    out = tmp_path / "out"
    summary = predict_batch(folder, out=out, predictor=PredictorDouble(), batch_size=2, processes=processes)
    assert (summary.predicted, summary.failed, summary.exit_code) == (5, 0, 0)
    rows = table(out)
    assert list(rows[0])[:6] == COLUMNS
    names = [row["name"] for row in rows]
    assert names == ["a", "short", "wide", "sub__a", "sub__deep__tall"]
    for row in rows:
        alone = predict(row["path"], predictor=PredictorDouble())
        assert float(row["youngs_modulus"]) == alone.youngs_modulus
        record = json.loads((out / "clips" / f"{row['name']}.json").read_text())
        assert record["youngs_modulus"] == alone.youngs_modulus
        assert (out / "clips" / record["skinning_weights"]).is_file()
        assert (out / "clips" / f"{row['name']}.jpg").stat().st_size > 500
    parquet = pyarrow.parquet.read_table(out / "predictions.parquet")
    assert parquet.column_names[:6] == COLUMNS
    assert parquet["youngs_modulus"].to_pylist() == [float(row["youngs_modulus"]) for row in rows]
    assert parquet.schema.field("youngs_modulus_low").metadata == {b"unit": b"Pa"}
    assert not list(out.rglob(".partial-*"))


def test_iter_predictions_yields_each_clip_once(folder: Path) -> None:
    predictor = PredictorDouble()
    results = list(iter_predictions([folder], predictor=predictor, batch_size=3, processes=False))
    assert len({result.source.key for result in results}) == 5
    assert all(result.prediction is not None and not result.error for result in results)
    assert max(predictor.batches) <= 3 and sum(predictor.batches) == 5
    assert all(name.startswith("clip-reader") for name in predictor.threads), "reading is off the main thread"


@pytest.mark.slow
def test_leaving_the_iteration_early_stops_the_readers(folder: Path) -> None:
    import threading

    results = iter_predictions(folder, predictor=PredictorDouble(), batch_size=1)
    next(results)
    results.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("clip-")]


def test_a_second_run_does_only_what_is_new_or_changed(tmp_path: Path, folder: Path, make_clip: MakeClip) -> None:
    out = folder / "out"  # below the inputs: it must not be read
    first = predict_batch(folder, out=out, predictor=PredictorDouble(), processes=False)
    before = table(out)
    again = PredictorDouble()
    second = predict_batch(folder, out=out, predictor=again, processes=False)
    assert (second.predicted, second.resumed, again.batches) == (0, 5, [])
    assert table(out) == before and second.rows == first.rows
    make_clip(folder / "a.mp4", frames=10)
    make_clip(folder / "new" / "a.mp4")
    third = predict_batch(folder, out=out, predictor=PredictorDouble(), processes=False)
    assert (third.predicted, third.resumed) == (2, 4)
    assert len(table(out)) == 6
    runs = json.loads((out / "run.json").read_text())["runs"]
    assert [run["predicted"] for run in runs] == [5, 0, 2]
    assert runs[0]["configuration"]["batch_size"] == 8 and runs[0]["command"]


@pytest.mark.parametrize("change", [{"density": 500.0}, {"predictor": PredictorDouble(config="other")}, {"redo": True}])
def test_other_settings_checkpoint_or_redo_predict_again(tmp_path: Path, make_clip: MakeClip, change: dict) -> None:
    clip = make_clip(tmp_path / "a.mp4")
    predict_batch(clip, out=tmp_path / "out", predictor=PredictorDouble())
    summary = predict_batch(clip, out=tmp_path / "out", **({"predictor": PredictorDouble()} | change))
    assert (summary.predicted, summary.resumed) == (1, 0)
    assert len(table(tmp_path / "out")) == 1


def test_a_clip_whose_files_were_deleted_or_emptied_is_done_again(tmp_path: Path, make_clip: MakeClip) -> None:
    clip = make_clip(tmp_path / "a.mp4")
    predict_batch(clip, out=tmp_path / "out", predictor=PredictorDouble())
    (tmp_path / "out" / "clips" / "a.skinning.safetensors").unlink()
    assert predict_batch(clip, out=tmp_path / "out", predictor=PredictorDouble()).predicted == 1
    (tmp_path / "out" / "clips" / "a.json").write_bytes(b"")
    assert predict_batch(clip, out=tmp_path / "out", predictor=PredictorDouble()).predicted == 1


def test_results_of_other_folders_stay_in_the_table(tmp_path: Path, make_clip: MakeClip) -> None:
    first, second = make_clip(tmp_path / "x" / "a.mp4"), make_clip(tmp_path / "y" / "a.mp4")
    predict_batch(first, out=tmp_path / "out", predictor=PredictorDouble())
    summary = predict_batch(second, out=tmp_path / "out", predictor=PredictorDouble())
    assert [row.path for row in summary.rows] == [str(second)]
    rows = table(tmp_path / "out")
    assert [row["path"] for row in rows] == [str(second), str(first)]
    assert rows[0]["name"] != rows[1]["name"]


@pytest.mark.parametrize("fail_on", ["raise", "nan"])
def test_one_clip_that_breaks_the_network_fails_alone(
    tmp_path: Path,
    make_clip: MakeClip,
    fail_on: str,
    caplog: pytest.LogCaptureFixture,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("a", "b", "c"):
        make_clip(tmp_path / "clips" / f"{name}.mp4")
    red = make_clip(tmp_path / "clips" / "red.mp4", colour=(230, 20, 20))
    out = tmp_path / "out"
    summary = predict_batch(
        tmp_path / "clips", out=out, predictor=PredictorDouble(fail_on=fail_on), processes=False, workers=1
    )
    assert (summary.predicted, summary.failed, summary.exit_code) == (3, 1, 1)
    (row,) = [row for row in table(out) if row["error"]]
    assert row["path"] == str(red) and str(red) in row["error"] and "\n" not in row["error"]
    assert row["youngs_modulus"] == ""
    assert [(record.name, str(red) in record.message) for record in caplog.records] == [("physconvex", True)]
    assert capsys.readouterr().err == ""  # the library logs; the command prints
    entries = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    assert any("Traceback" in entry["details"] for entry in entries)


@pytest.mark.slow
def test_a_crash_of_the_reading_process_fails_one_clip(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(
        "import os, signal, physconvex.io as io\n"
        "read = io.read_video\n"
        "def deadly(path, **options):\n"
        "    if path.name == 'short.mp4': os.kill(os.getpid(), signal.SIGSEGV)\n"
        "    return read(path, **options)\n"
        "io.read_video = deadly\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), str(Path.cwd())]))
    summary = predict_batch(folder, out=tmp_path / "out", predictor=PredictorDouble(), processes=True)
    assert (summary.predicted, summary.failed) == (4, 1)
    (row,) = [row for row in summary.rows if row.error]
    assert row.path.endswith("short.mp4") and "SIGSEGV" in row.error


def test_a_torn_journal_line_is_done_again(tmp_path: Path, folder: Path) -> None:
    out = tmp_path / "out"
    predict_batch(folder, out=out, predictor=PredictorDouble(), processes=False)
    journal = out / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-40])
    summary = predict_batch(folder, out=out, predictor=PredictorDouble(), processes=False)
    assert (summary.predicted, summary.resumed) == (1, 4)
    assert predict_batch(folder, out=out, predictor=PredictorDouble(), processes=False).resumed == 5


def test_one_writer_at_a_time(tmp_path: Path, make_clip: MakeClip) -> None:
    clip, out = make_clip(tmp_path / "a.mp4"), tmp_path / "out"

    def start_another(row: ResultRow) -> None:
        predict_batch(clip, out=out, predictor=PredictorDouble())

    with pytest.raises(InputError, match="another run is writing"):
        predict_batch(clip, out=out, predictor=PredictorDouble(), on_row=start_another)


def test_bad_options_and_output_folder(tmp_path: Path, make_clip: MakeClip) -> None:
    clip = make_clip(tmp_path / "a.mp4")
    with pytest.raises(InputError, match="batch_size is 0"):
        predict_batch(clip, out=tmp_path / "out", predictor=PredictorDouble(), batch_size=0)
    with pytest.raises(InputError, match="out is"):
        predict_batch(clip, out=clip / "out", predictor=PredictorDouble())


_KILLED = """
import sys
from inference import predict_batch
from tests.inference.predictor_double import PredictorDouble
predictor = PredictorDouble(pause=0.3)
predict_batch(sys.argv[1], out=sys.argv[2], predictor=predictor, batch_size=1, processes=False)
"""


@pytest.mark.slow
def test_nothing_finished_is_lost_on_a_kill(tmp_path: Path, folder: Path) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen([sys.executable, "-c", _KILLED, str(folder), str(out)])
    journal = out / "journal.jsonl"
    deadline = time.monotonic() + 60
    while not (journal.is_file() and journal.read_bytes().count(b"\n") >= 2):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    finished = [json.loads(line)["row"] for line in journal.read_text().splitlines(keepends=True) if line[-1] == "\n"]
    assert 2 <= len(finished) < 5
    kept = {row["path"]: float(row["youngs_modulus"]) for row in table(out) if row["poisson_ratio_std"]}
    assert all(kept[row["path"]] == row["youngs_modulus"] for row in finished[:-1])
    summary = predict_batch(folder, out=out, predictor=PredictorDouble(), processes=False)
    assert summary.resumed >= len(finished) and summary.resumed + summary.predicted == 5
    values = {row.path: row.youngs_modulus for row in summary.rows}
    assert all(values[row["path"]] == row["youngs_modulus"] for row in finished)


def test_closing_a_reader_ends_its_threads_even_where_they_wait_to_hand_over() -> None:
    read = []

    def reader(source: ClipSource) -> Failure:
        read.append(source)
        return Failure(source, "not read")

    before = set(threading.enumerate())
    sources = [ClipSource(Path(f"{k}.mp4"), "video", str(k)) for k in range(50)]
    background = BackgroundReader(sources, lambda: reader, workers=3, ahead=1)
    next(background.batches(1))
    assert set(threading.enumerate()) > before
    background.close()
    assert set(threading.enumerate()) <= before
    assert len(read) < len(sources)
