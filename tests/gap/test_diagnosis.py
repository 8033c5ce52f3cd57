"""A whole diagnosis, by the command, of a small capture made on another mesh with other steps."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
import trimesh
import typer
from PIL import Image
from typer.testing import CliRunner

from physconvex import InputError
from physconvex.dynamics import Timing, simulate
from physconvex.io import Capture, Floor, Tracks, load_capture, save_capture


def thrown_block(folder, velocity, seed):
    """A block that falls on a rough floor, of which the capture says nothing."""
    from physconvex.dynamics import Plane
    from physconvex.fem import ElasticBody, Scene
    from physconvex.mesh import Embedding, box_mesh

    mesh = box_mesh((0.2, 0.1, 0.1), (4, 2, 2), order=2)
    body = ElasticBody(mesh, youngs_modulus=3e4, poisson_ratio=0.35)
    floor = Plane(point=(0, 0, -0.02), friction=0.4)
    scene = Scene(body, obstacles=(floor,), initial_velocity=velocity)
    run = simulate(scene, Timing(frames=12, fps=100.0, steps_per_frame=10))
    surface = trimesh.creation.box(extents=(0.2, 0.1, 0.1)).apply_translation((0.1, 0.05, 0.05))
    points, _ = trimesh.sample.sample_surface_even(surface, 25, seed=seed)
    positions = Embedding.of_points(mesh, points).apply(run.positions)
    rng = np.random.default_rng(seed)
    noisy = positions + 1e-4 * rng.normal(size=positions.shape)
    save_capture(
        Capture(folder, 100.0, 12, 8, floor=Floor(np.array([0, 0, -0.02]), np.array([0.0, 0, 1])),
                initial_velocity=np.array(velocity), initial_angular_velocity=np.zeros(3)),
        mesh=surface, tracks=Tracks(points, noisy, np.full(noisy.shape[:2], 1e-4)),
    )  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return thrown_block(tmp_path_factory.mktemp("gap") / "block", (1.0, 0, -0.5), 1)


@pytest.fixture(scope="module")
def second_take(tmp_path_factory):
    """The same block, thrown otherwise."""
    return thrown_block(tmp_path_factory.mktemp("gap") / "again", (0.5, 0.8, -0.7), 2)


@pytest.fixture(scope="module")
def diagnosed(capture, second_take, tmp_path_factory):
    """The command's output folder, of a capture whose rest geometry is given apart.

    The fine mesh, which the command line does not offer, has few nodes.
    """
    from inference.diagnosis_command import diagnose_command
    from physconvex.gap import diagnosis

    def with_few_nodes(capture, *, options, **how):
        return whole(capture, options=options.replace(fine_nodes=200), **how)

    app, out = typer.Typer(), tmp_path_factory.mktemp("diagnosed")
    app.command()(diagnose_command)
    bare = shutil.copytree(capture, tmp_path_factory.mktemp("bare") / "block")
    (bare / "mesh.obj").unlink()
    arguments = [
        str(bare),
        "--body",
        str(capture / "mesh.obj"),
        "--second-take",
        str(second_take),
        "--out",
        str(out),
        "--no-progress",
    ]
    arguments += ["--max-nodes", "60"]
    arguments += ["--candidates", "2", "--effects", "friction,gravity_tilt,air_drag,damping"]
    with pytest.MonkeyPatch.context() as patch:
        whole = diagnosis.diagnose
        patch.setattr(diagnosis, "diagnose", with_few_nodes)
        ended = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert ended.exit_code == 0 and "friction" in ended.stdout
    return out


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_command_names_friction(diagnosed):
    content = json.loads((diagnosed / "report.json").read_text())
    which, how_far = content["which"], content["how_far"]
    assert which["verdict"] == "effect" and which["effects"][0]["name"] == "friction"
    dose = which["effects"][0]["parameters"][0]
    assert dose["unit"] == "" and dose["value"] == pytest.approx(0.4, rel=0.35)
    assert how_far["shrinkage"] > 0.6 > (how_far["placebo"] or 0.0)
    assert how_far["gap_after"] < how_far["gap_before"] and how_far["unit"] == "m"
    assert {p["name"] for p in content["where"]["sources"]} == {
        "noise", "discretisation", "appearance and geometry", "camera and time", "dynamics explained", "unexplained",
    }  # fmt: skip
    assert len(content["where"]["frames"]) == 12 and content["provenance"]["fitted"] == list(range(8))
    page = (diagnosed / "report.html").read_text()
    assert which["sentence"].split(" (")[0] in page
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)", page) and page.count("<svg") >= 5
    body = trimesh.load(diagnosed / "body.ply")
    assert body.is_watertight and np.ptp(body.visual.vertex_colors[:, :3], axis=0).max() > 20


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_friction_found_on_one_take_holds_on_another(diagnosed):
    content = json.loads((diagnosed / "report.json").read_text())
    again = content["how_far"]["all"][-1]
    assert again["data"].startswith("second take")
    assert again["gap_after"] < 0.5 * again["gap_before"] and again["shrinkage"] > 0.7
    assert "second take" in (diagnosed / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_inert_effect_is_never_named(capture, diagnosed):
    """A dose that does nothing explains nothing: the answer is what it is without."""
    from physconvex.gap import Dose, Effect, GapOptions, diagnose

    inert = Effect(
        "inert", "material", (Dose("amount", "", -1.0, 1.0, 0.01, lambda s: 0.1),), scene=lambda scene, _: scene
    )
    names = ("friction", "gravity_tilt", "air_drag", "damping", "inert")
    options = GapOptions(max_nodes=60, fine_nodes=200, candidates=2)
    report = diagnose(capture, effects=names, extra=[inert], options=options)
    before = json.loads((diagnosed / "report.json").read_text())["which"]
    assert [e.name for e in report.verdict.effects] == [e["name"] for e in before["effects"]]
    assert all("inert" not in h.names for h in report.hypotheses[:1]) and "inert" not in report.verdict.sentence
    entry = next(e for e in report.screening.ranked if e.effect.name == "inert")
    assert entry.score.statistic == pytest.approx(0.0, abs=1e-9) and not np.any(entry.score.amounts)
    shown = report._repr_html_()
    assert "gap shrinks by" in shown and "friction: " in shown and "<svg" in shown


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_second_take_without_the_floor_is_refused(capture, second_take, tmp_path):
    from types import SimpleNamespace

    from physconvex.gap import DEFAULT_EFFECTS, GapOptions
    from physconvex.gap.shrinkage import second_take_shrinkage

    folder = tmp_path / "no_floor"
    shutil.copytree(second_take, folder)
    content = json.loads((folder / "capture.json").read_text())
    content["floor"] = None
    (folder / "capture.json").write_text(json.dumps(content))
    friction = next(e for e in DEFAULT_EFFECTS if e.name == "friction")
    best = SimpleNamespace(effects=(friction,))
    base = SimpleNamespace(situation=SimpleNamespace(giving_floor=False))
    with pytest.raises(InputError, match="friction cannot act there"):
        second_take_shrinkage(base, best, load_capture(folder), GapOptions(max_nodes=60), lambda _: None)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")
def test_page_opens_in_a_browser(diagnosed, tmp_path):
    picture = tmp_path / "page.png"
    subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1000,3000",
         f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}", (diagnosed / "report.html").as_uri()],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    pixels = np.asarray(Image.open(picture).convert("RGB"))
    rows = (pixels < 200).any(-1).any(1)  # ink from top to bottom
    assert rows[: len(rows) // 2].mean() > 0.3 and rows[len(rows) // 2 :].mean() > 0.3
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 200


def test_a_capture_without_tracks_is_refused(tmp_path):
    folder = tmp_path / "empty"
    save_capture(Capture(folder, 24.0, 12, 8), mesh=trimesh.creation.box())
    from physconvex.gap import diagnose

    with pytest.raises(InputError, match=r"tracks\.npz"):
        diagnose(folder)


def test_unknown_effects_are_refused(capture):
    from physconvex.gap import diagnose

    with pytest.raises(InputError, match="gremlins"):
        diagnose(load_capture(capture), effects=["gremlins"])
