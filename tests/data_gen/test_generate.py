"""Generation: replaced failures, engines, and the same bytes after a kill, with more workers, or on a cluster."""

import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

import data_gen.generate
from data_gen import (
    Dataset,
    ObjectMesh,
    SolverConfig,
    draw_drop,
    generate_dataset,
    load_config,
    make_mesh,
    simulate_drop,
)
from data_gen.engines import WorkerOptions, run_tasks
from data_gen.simulate import Samples, SimulatedDrop
from physconvex import ConvergenceError, InputError
from physconvex.dynamics import SolveStatistics
from physconvex.fem import Trajectory
from physconvex.mesh import Embedding, box_mesh

SMALL = [
    "video={frames: 4, width: 48, height: 48, supersampling: 1}",
    "solver={target_nodes: 100, landing_nodes: 20, steps_per_frame: 2, tolerance: 1.0e-3, max_attempts: 3}",
    "motion.drop_height=[0.05, 0.1]",
    "camera.views=1",
    "samples={points: 8, modes: 2}",
]
CONFIG = load_config("training", overrides=SMALL)


def contents(root: Path) -> dict[str, str]:
    """Checksum of every file but the one that holds times."""
    files = [p for p in sorted(root.rglob("*")) if p.is_file() and p.name != "timings.jsonl"]
    return {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def falling_box(drop, config, rng) -> SimulatedDrop:
    """What `simulate_drop` returns, for a rigid body in free fall without a solver."""
    size = drop.body.size
    mesh = box_mesh((size, size, size), (1, 1, 1))
    times = np.arange(config.video.frames) / config.video.fps
    fall = np.stack([0 * times, 0 * times, -9.81 / 2 * times**2], axis=1)[:, None]
    trajectory = Trajectory(
        times, mesh.vertices + fall, np.zeros((len(times), *mesh.vertices.shape)), SolveStatistics()
    )
    points = rng.random((config.samples.points, 3)) * size
    embedding = Embedding.of_points(mesh, points)
    modes = embedding.apply(mesh.vertices[:, : config.samples.modes])
    weights = np.full(len(points), mesh.volume / len(points))
    samples = Samples(points, weights, embedding.apply(trajectory.positions) - points, modes, np.ones(2))
    return SimulatedDrop(mesh, trajectory, drop.placed(drop.body.vertices) + fall, samples)


@pytest.fixture
def in_process(monkeypatch):
    """Run tasks here, on boxes instead of random objects."""
    box = trimesh.creation.box()
    body = ObjectMesh(np.asarray(box.vertices), np.asarray(box.faces), "box", "user")
    monkeypatch.setattr("data_gen.scene.random_object", lambda rng: body)
    monkeypatch.setattr(data_gen.generate, "run_tasks", lambda function, tasks, _: map(function, tasks))
    monkeypatch.setattr(data_gen.generate, "simulate_drop", falling_box)
    return monkeypatch


def test_labels_and_pictures_agree_with_the_drop(in_process, tmp_path):
    summary = generate_dataset(tmp_path, count=2, config=CONFIG, seed=1)
    assert (summary.made, summary.already_there, summary.failed_attempts, summary.given_up) == (2, 0, 0, ())
    data = Dataset.open(tmp_path)
    assert data.verify() == [] and len(data) == 2
    for clip in data.clips:
        row, samples = clip.row, clip.samples()
        assert 1e4 <= row["youngs_modulus"] <= 1e7 and row["fps"] == 24.0 and row["frames"] == 4
        fall = -9.81 / 2 * (np.arange(4) / 24) ** 2
        np.testing.assert_allclose(samples.displacements[:, 0, 2], fall, atol=1e-6)
        assert samples.modes.shape == (8, 2)
        assert samples.volume_weights.sum() == pytest.approx(row["volume"], rel=1e-5)
        mask = clip.mask()
        assert mask.shape == (4, 48, 48) and 0.005 < mask.mean() < 0.6
        heights = [np.argwhere(frame)[:, 0].mean() for frame in mask]
        assert np.all(np.diff(heights) > 0)  # rows grow downwards


def test_failed_attempts_are_replaced_recorded_and_not_repeated(in_process, tmp_path):
    tried = []

    def fails_twice_for_number_one(drop, config, rng):
        tried.append(drop.youngs_modulus)
        if 2 <= len(tried) <= 3:
            raise ConvergenceError("no mesh")
        return falling_box(drop, config, rng)

    in_process.setattr(data_gen.generate, "simulate_drop", fails_twice_for_number_one)
    reports = []
    summary = generate_dataset(tmp_path, count=2, config=CONFIG, seed=1, on_report=lambda *told: reports.append(told))
    assert summary.failed_attempts == 2 and len(set(tried)) == 4
    rows = [clip.row for clip in Dataset.open(tmp_path).clips]
    assert [row["attempt"] for row in rows] == [0, 2] and rows[1]["youngs_modulus"] == tried[3]
    assert [(len(report.failures), done) for report, done in reports] == [(0, 1), (2, 2)]
    notes = [json.loads(line) for line in (tmp_path / "failures.jsonl").read_text().splitlines()]
    assert [(note["simulation"], note["attempt"]) for note in notes] == [(1, 0), (1, 1)]
    assert "no mesh" in notes[0]["message"]
    again = generate_dataset(tmp_path, count=2, config=CONFIG, seed=1)
    assert (again.made, again.already_there) == (0, 2) and len(tried) == 4


def test_a_hopeless_simulation_is_given_up_and_the_rest_made(in_process, tmp_path):
    def always_fails_first(drop, config, rng):
        if not (tmp_path / "given_up").exists():
            raise ConvergenceError("too thin")
        return falling_box(drop, config, rng)

    in_process.setattr(data_gen.generate, "simulate_drop", always_fails_first)
    summary = generate_dataset(tmp_path, count=2, config=CONFIG, seed=1)
    assert summary.given_up == (0,) and summary.made == 1 and summary.failed_attempts == 3
    assert Dataset.open(tmp_path).manifest["given_up"] == [0]


def test_adding_simulations_keeps_the_others(in_process, tmp_path):
    generate_dataset(tmp_path / "grown", count=1, config=CONFIG, seed=1)
    settled = []
    generate_dataset(
        tmp_path / "grown", count=2, config=CONFIG, seed=1, on_report=lambda report, done: settled.append(done)
    )
    assert settled == [2]  # of two, one was there
    generate_dataset(tmp_path / "whole", count=2, config=CONFIG, seed=1)
    assert contents(tmp_path / "grown") == contents(tmp_path / "whole")


def test_a_folder_of_another_seed_or_configuration_is_refused(in_process, tmp_path):
    generate_dataset(tmp_path, count=1, config=CONFIG, seed=1)
    with pytest.raises(InputError, match="another seed"):
        generate_dataset(tmp_path, count=1, config=CONFIG, seed=2)
    with pytest.raises(InputError, match="another configuration"):
        generate_dataset(tmp_path, count=1, config=load_config("clean", overrides=SMALL), seed=1)


@pytest.mark.wrong_types
def test_wrong_arguments_are_named(tmp_path):
    with pytest.raises(InputError, match="count"):
        generate_dataset(tmp_path, count=0, config=CONFIG)
    with pytest.raises(InputError, match="workers"):
        WorkerOptions(workers=0)
    with pytest.raises(InputError, match="engine"):
        WorkerOptions(engine="slurm")


@pytest.mark.parametrize("engine, module", [("ray", "ray"), ("dask", "distributed")])
def test_an_engine_that_is_not_installed_names_its_extra(monkeypatch, engine, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"physconvex\[{engine}\]"):
        list(run_tasks(math.factorial, [1], WorkerOptions(engine=engine)))


def test_local_workers_have_one_thread_and_leave_the_environment_alone(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    names = ["OMP_NUM_THREADS", "MKL_NUM_THREADS", "MKL_CBWR"]
    assert sorted(run_tasks(os.getenv, names, WorkerOptions(workers=2))) == ["1", "1", "AUTO"]
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_user_mesh_without_volume_fails_as_a_simulation():
    flat = trimesh.creation.box(extents=(1, 1, 1))
    flat.vertices[:, 2] *= 1e-12
    body = ObjectMesh(np.asarray(flat.vertices), np.asarray(flat.faces), "flat", "user")
    patch = pytest.MonkeyPatch()
    patch.setattr("data_gen.scene.random_object", lambda rng: body)
    drop = data_gen.generate.draw_drop(CONFIG, 0, 0, 0)
    patch.undo()
    with pytest.raises(ConvergenceError, match="flat"):
        simulate_drop(drop, CONFIG, np.random.default_rng(0))


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> dict[str, str]:
    """Three simulations made without interruption by one worker."""
    root = tmp_path_factory.mktemp("reference")
    generate_dataset(root, count=3, config=CONFIG, seed=4)
    assert Dataset.open(root).verify() == []
    return contents(root)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_kill_and_more_workers_change_no_byte(reference, tmp_path):
    root = tmp_path / "killed"
    settings = [word for setting in SMALL for word in ("--set", setting)]
    code = "from data_gen.commands import app; app()"
    arguments = ["dataset", "--out", str(root), "--count", "3", "--seed", "4", "--workers", "1", *settings]
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while process.poll() is None and not list(root.glob("simulations/0*")):
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not (root / "manifest.json").exists()
    with pytest.raises(InputError, match="cut off"):
        Dataset.open(root)
    summary = generate_dataset(root, count=3, config=CONFIG, seed=4, work=WorkerOptions(workers=2))
    assert summary.already_there >= 1 and summary.made + summary.already_there == 3
    assert contents(root) == reference


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("engine, module", [("dask", "distributed"), ("ray", "ray")])
@pytest.mark.filterwarnings("ignore::DeprecationWarning:distributed", "ignore::ResourceWarning")
def test_a_local_cluster_of_two_workers_gives_the_same_bytes(reference, tmp_path, engine, module):
    pytest.importorskip(module)
    generate_dataset(tmp_path, count=3, config=CONFIG, seed=4, work=WorkerOptions(workers=2, engine=engine))
    assert contents(tmp_path) == reference


def test_a_procedural_body_that_cannot_be_meshed_is_a_failed_attempt():
    """This letter's triangles overlap; the mesher's complaint used to end the whole run."""
    drop = draw_drop(load_config("training"), 1, 678, 0)
    with pytest.raises(ConvergenceError, match=rf"{drop.object_id}: surface: not closed"):
        make_mesh(drop, SolverConfig(target_nodes=500), (0.0, 0.0, -9.81))
