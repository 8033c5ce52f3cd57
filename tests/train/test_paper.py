"""The tables of a benchmark: arithmetic of the means, and one object from its generation to its row."""

import json
import os
import shutil

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from physconvex import InputError
from physconvex.io import load_capture, read_mesh
from train import PaperOptions, evaluate_paper
from train.paper import evaluation, published
from train.paper.published_way import WAYS
from train.paper.rows import ObjectRow
from train.paper.tables import markdown, summary

MAIN = ("reconstruction", "constant", "network", "convex_twin", "corrected", "followed", "given_mesh")
SMALL = PaperOptions(
    max_nodes=80, fine_nodes=80, weights=3, full_runs=1, model_error=False, adam_steps=3, ablation=(0,),
    field_budget=200, field_steps=8, steps_per_frame=4, ablation_points=(3,),
)  # fmt: skip


def row(name, error, covered, psnr):
    picture = {"psnr": psnr, "ssim": 0.9, "psnr_object": psnr - 8, "fovvdp": None}
    motion = {"pictures": {"observed": {"front": picture}, "future": {"front": picture}}}
    stored = {
        "object": name,
        "truth": {"log10_youngs_modulus": 5.0, "poisson_ratio": 0.3},
        "constant": {"errors": [0.5, 0.045], "process_seconds": 0.0},
        "network": {"failure": "InputError: dark", "process_seconds": 0.1},
        "corrected": {
            "errors": error,
            "covered": covered,
            "intervals_90": [None if c is None else [5.0, 5.2] for c in covered],
            "convexes": 200 * psnr,
            "process_seconds": 30.0,
            "changes": {"pushed": {"rms_m": 1e-3, "change_rms_m": 0.2}},
            **motion,
        },
        "reconstruction": {
            "convexes": 200 * psnr,
            "first_images": {"psnr": 40.0, "ssim": 0.99},
            "volume_error": -0.02,
            "process_seconds": 90.0,
        },
        "reconstruction_K4": {"convexes": 100, "first_images": {"psnr": 39.0}, "process_seconds": 50.0},
        "convex_K4_M8": {"errors": [-0.1, 0.0], "convexes": 100, "process_seconds": 3.0, **motion},
        "truth_itself": {"nodes": 900, "pictures": {"future": {"front": {"psnr": psnr - 10, "ssim": 0.8}}}},
    }
    return ObjectRow.of_json(stored)


def test_means_are_of_absolutes_and_failures_are_named():
    rows = [row("mug", [0.02, -0.01], [True, None], 30.0), row("lion", [-0.04, 0.03], [False, True], 34.0)]
    told = summary(rows)
    corrected = told.identification["corrected"]
    assert (corrected.log10_error, corrected.poisson_error) == (pytest.approx(0.03), pytest.approx(0.02))
    assert "network" not in told.identification and told.failures[0] == "mug: network: InputError: dark"
    assert (corrected.coverage_90, corrected.intervals) == (pytest.approx(2 / 3), 3)
    assert corrected.process_seconds == pytest.approx(120.0)  # with the reconstruction
    assert told.identification["convex_K4_M8"].process_seconds == pytest.approx(53.0)
    assert told.pictures["corrected"]["future"]["front"]["psnr"] == pytest.approx(32.0)
    assert told.changes["pushed"]["change_rms_m"] == pytest.approx(0.2)
    page = markdown(rows, "two objects")
    assert "| mug | 5.00, 0.30 | +0.500 / +0.045 | failed | +0.020 / -0.010 |" in page
    assert "| truth of half the nodes | future | front | 22.00 | 0.8000 | – | – |" in page
    assert "| corrected | 2 | 0.030 | 0.020 | 0.67 of 3 | 120 | 6400 |" in page
    assert "with 6400 convexes in the mean (40.0 dB), its volume 2.0 % off in the mean, in 90 s" in page
    assert "| lion | 0.100 ! / 0.100 |" in page and "| mug | 0.100 / none |" in page
    assert "| 4 | 8 | 2 | 32.00 | 0.9000 | – | 32.00 | 0.9000 | – | 0.100 | 0.000 | 100 | 53 |" in page
    assert "| pushed | 1.0 | 200.0 |" in page


def test_changes_count_where_the_truth_has_them():
    """Truths of `generate benchmark --no-changes` beside others."""
    with_them, without = (row(name, [0.0, 0.0], [True, True], 30.0) for name in ("mug", "lion"))
    without.parts["corrected"]["changes"] = {}
    for rows in ([with_them, without], [without, with_them]):
        assert summary(rows).changes == {"pushed": {"rms_m": pytest.approx(1e-3), "change_rms_m": pytest.approx(0.2)}}
    assert summary([without]).changes == {}


def test_published_numbers_stand_beside_and_are_marked():
    page = markdown([row("mug", [0.02, -0.01], [True, None], 30.0)], "one object")
    assert "| *PhysConvex, published* | 12 | 0.37 | 0.04 | – | 360 (GPU) | 23681 |" in page
    assert "| *PhysConvex, published* | future | – | 25.71 | 0.9480 | – | 7.68 |" in page
    assert "| *published* | 29.47 | 0.9590 | 8.15 | 24.55 | 0.9440 | 7.61 | 0.35 | 0.05 | 14392 | – |" in page
    assert "arXiv 2602.18886" in page and "cannot be compared" in page
    for errors, mean in ((published.LOG10_ERRORS, 0.37), (published.POISSON_ERRORS, 0.04)):  # as the paper's own mean
        assert np.mean(errors) == pytest.approx(mean, abs=0.01)
    assert np.mean(published.OBSERVED_PSNR) == pytest.approx(30.00, abs=0.01)


def test_an_object_that_is_not_finished_counts_where_it_can():
    truth = {"log10_youngs_modulus": 6.0, "poisson_ratio": 0.4}
    begun = ObjectRow("bus", truth, parts={"constant": {"errors": [-0.5, 0.0], "process_seconds": 0.0}})
    told = summary([row("mug", [0.02, -0.01], [True, None], 30.0), begun])
    assert told.identification["constant"].objects == 2 and told.identification["corrected"].objects == 1
    assert "| bus | 6.00, 0.40 | -0.500 / +0.000 | – | – |" in markdown([row("mug", [0, 0], [True], 30.0), begun], "")


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory):
    """One painted ball, tiny."""
    from data_gen.commands import app

    root = tmp_path_factory.mktemp("paper")
    (root / "objects" / "ball").mkdir(parents=True)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    waves = 127 + 120 * np.sin(12 * ball.vertices @ np.array([[1, 0.3, 0], [0, 1, 0.4], [0.5, 0, 1]]))
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=waves.astype(np.uint8))
    ball.export(root / "objects" / "ball" / "ball.ply")
    sizes = "--count 1 --size 64 --views 3 --frames 8 --observed-frames 7 --nodes 100 --steps-per-frame 8"
    command = f"benchmark --objects {root / 'objects'} --out {root / 'made'} {sizes} --modulus 4.5 4.6 --no-progress"
    result = CliRunner().invoke(app, command.split())
    assert result.exit_code == 0, result.output
    return root / "made"


@pytest.mark.slow
def test_a_benchmark_shows_images_alone_and_keeps_truth_apart(benchmark):
    files = {path.name for path in (benchmark / "captures" / "ball").iterdir()}
    stills = {f"view{k}{end}" for k in (1, 2) for end in (".png", "_mask.png")}
    assert files == {"capture.json", "view0.mp4", "view0_mask.mp4"} | stills
    capture = load_capture(benchmark / "captures" / "ball")
    assert capture.mesh() is None and len(capture.pictured) == 3
    assert [camera.name for camera in capture.recorded] == ["view0"]
    surface = read_mesh(benchmark / "truth" / "ball" / "mesh.ply")
    for camera in capture.pictured:  # the picture is that of the true mesh
        rows, columns = np.nonzero(capture.first_mask(camera.name))
        pixels, _ = camera.project(surface.vertices)
        np.testing.assert_allclose([columns.min(), rows.min()], pixels.min(axis=0), atol=1.1)
        np.testing.assert_allclose([columns.max() + 1, rows.max() + 1], pixels.max(axis=0), atol=1.1)
    truth = json.loads((benchmark / "truth" / "ball" / "truth.json").read_text())
    assert 4.5 <= np.log10(truth["youngs_modulus"]) <= 4.6
    for label in ("half_steps", "half_nodes"):
        assert len(truth[f"psnr_to_{label}"]) == len(truth[f"ssim_to_{label}"]) == 8
        assert truth[f"rms_to_{label}_m"][0] == pytest.approx(0, abs=5e-3) and max(truth[f"rms_to_{label}_m"]) > 1e-5
    assert truth["psnr_to_half_nodes"][-1] < truth["psnr_to_half_nodes"][0]
    with np.load(benchmark / "truth" / "ball" / "points.npz") as arrays:
        assert arrays["positions"].shape == (8, len(arrays["rest"]), 3)
        assert np.abs(arrays["positions_pushed"] - arrays["positions"]).max() > 0.05


@pytest.mark.slow
def test_a_capture_holds_as_many_videos_as_are_observed_and_changes_can_be_left_out(benchmark, tmp_path):
    from data_gen import BenchmarkOptions
    from data_gen.benchmark import generate_benchmark

    sizes = BenchmarkOptions(
        count=1, size=64, views=4, observed_views=2, frames=2, observed_frames=2, nodes=60, steps_per_frame=1,
        checked=False, changed=False,
    )  # fmt: skip
    generate_benchmark(benchmark.parent / "objects", tmp_path, sizes)
    with np.load(tmp_path / "truth" / "ball" / "points.npz") as arrays:
        assert set(arrays) == {"rest", "positions"}
    capture = load_capture(tmp_path / "captures" / "ball")
    assert [camera.name for camera in capture.pictured] == ["view0", "view1", "view2", "view3"]
    assert [camera.name for camera in capture.recorded] == ["view0", "view2"]
    with pytest.raises(InputError, match="observed_views: got 5; expected at most views = 4"):
        sizes.replace(observed_views=5)


def test_settings_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    """Another evaluation of the same folder reads them meanwhile."""
    file, fewer = tmp_path / "options.json", SMALL.replace(adam_steps=0)
    evaluation._claim(file, fewer)
    before = file.read_text()

    def killed(source, target):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", killed)
    evaluation._claim(file, fewer)  # nothing is new
    with pytest.raises(KeyboardInterrupt):
        evaluation._claim(file, SMALL)
    assert file.read_text() == before


def test_the_published_way_alone_is_computed_with_its_start(benchmark, tmp_path, monkeypatch):
    """It begins at the network's prediction, and needs no other part; `comparisons` leaves it in where it is named."""
    monkeypatch.setattr(evaluation._Object, "_network", lambda _: {"values": [5.0, 0.3]})
    monkeypatch.setattr(evaluation._Object, "_published_way", lambda self, way: dict(self.row.parts["network"]))
    (found,) = evaluate_paper(benchmark, tmp_path, SMALL, parts=["published_way"], comparisons=False)
    assert list(found.parts) == ["network", "published_way"]
    assert found.parts["published_way"]["values"] == [5.0, 0.3]


@pytest.fixture(scope="module")
def evaluated(benchmark, tmp_path_factory):
    """The evaluation of a benchmark whose second object is not made yet: (folder, parts in order, what it returned)."""
    made, out = tmp_path_factory.mktemp("more") / "made", tmp_path_factory.mktemp("evaluated")
    shutil.copytree(benchmark, made)
    claim = json.loads((made / "benchmark.json").read_text())
    claim["objects"] = ["egg", "ball"]
    (made / "benchmark.json").write_text(json.dumps(claim))
    truth = made / "truth" / "ball" / "truth.json"
    truth.rename(made / "later.json")
    assert evaluate_paper(made, out, SMALL) == []
    (made / "later.json").rename(truth)
    parts = []
    for some in (["reconstruction", "network"], None):
        found = evaluate_paper(made, out, SMALL, parts=some, comparisons=False, on_part=lambda *x: parts.append(x))
    return out, parts, found


@pytest.mark.slow
def test_what_is_not_made_yet_is_left_for_later_and_comparisons_come_last(evaluated):
    _, parts, (found,) = evaluated
    chosen = ["reconstruction", "network"]
    assert parts == [("ball", part) for part in (*chosen, *(part for part in MAIN if part not in chosen))]
    assert found.truth_itself["nodes"] <= 100 and 0.5 < found.truth_itself["overlap"] <= 1


@pytest.mark.slow
def test_an_object_is_evaluated_part_by_part(benchmark, evaluated):
    options, (out, done, _) = SMALL, evaluated
    parts = []
    (found,) = evaluate_paper(benchmark, out, options, on_part=lambda *names: parts.append(names[1]))
    every = [*MAIN, *WAYS, "reconstruction_K3", "convex_K3_M10"]
    assert sorted(part for _, part in done) == sorted(MAIN)
    assert parts == every[len(MAIN) :]  # it goes on where it was left
    assert not [part for part in found.parts.values() if "failure" in part]
    assert abs(found.parts["given_mesh"]["errors"][0]) < abs(found.parts["constant"]["errors"][0])
    for part in ("corrected", "given_mesh"):  # two views and 200 convexes tell E within decades, if at all
        assert found.parts[part]["covered"][0] is not False
    assert found.parts["reconstruction"]["first_images"]["psnr"] > 15
    ratio, told = (found.parts[part]["values"][1] for part in ("convex_twin", "network"))
    assert ratio == pytest.approx(told, abs=0.01)  # few weights tell ν worse than the network
    for part in (*MAIN[1:], "published_way"):
        assert len(found.parts[part]["rms_m"]) == 8
        assert set(found.parts[part]["pictures"]) == {"observed", "future"}
        assert set(found.parts[part]["pictures"]["future"]) == {"front", "others"}
    assert set(found.parts["convex_K3_M10"]["pictures"]["future"]) == {"front"}
    assert "drift" in found.parts["followed"]
    assert set(found.parts["corrected"]["changes"]) == {"softer", "pushed", "moving_floor"}
    assert found.parts["published_way"]["steps"] == len(found.parts["published_way"]["losses"]) == 3
    assert "| 3 | 10 | 1 | " in markdown([found], "One object.")
    again = []
    evaluate_paper(benchmark, out, options, on_part=lambda *names: again.append(names))
    assert not again
    with pytest.raises(InputError, match=r"cube: not in .*expected some of ball"):
        evaluate_paper(benchmark, out, options, names=["cube"])
    with pytest.raises(InputError, match="parts: convex: unknown; expected some of reconstruction, constant"):
        evaluate_paper(benchmark, out, options, parts=["convex"])
    with pytest.raises(InputError, match="other options"):
        evaluate_paper(benchmark, out, PaperOptions())


def test_other_parts_may_be_chosen_later_but_not_other_settings(tmp_path):
    benchmark, out = tmp_path / "made", tmp_path / "out"
    benchmark.mkdir()
    (benchmark / "benchmark.json").write_text('{"objects": []}')
    for choice in (SMALL, SMALL.replace(ablation=(3,), ablation_points=(5, 6)), SMALL.replace(adam_steps=0)):
        assert evaluate_paper(benchmark, out, choice) == []
    for change, name in (({"adam_steps": 4}, "adam_steps"), ({"fine_nodes": 200}, "fine_nodes")):
        with pytest.raises(InputError, match=rf"other options \({name}\); choose another folder"):
            evaluate_paper(benchmark, out, SMALL.replace(**change))


def test_a_folder_without_a_benchmark_is_named(tmp_path):
    with pytest.raises(InputError, match="physconvex generate benchmark"):
        evaluate_paper(tmp_path, tmp_path / "out")
