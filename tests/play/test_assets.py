"""What can be played beside one mesh: several objects, convex fields, refined captures."""

import json

import numpy as np
import pytest
import torch
import trimesh
from typer import Typer
from typer.testing import CliRunner

from inference.simulation_command import simulate_command
from physconvex import InputError
from physconvex.convex import ConvexField, half_spaces, read_ply, write_ply
from physconvex.io import read_video
from physconvex.play import load_play_config, overrides_of, play, play_together, read_asset, read_surface

QUICK = ["basis.max_nodes=80", "basis.modes=2", "time.frames=3", "time.steps_per_frame=4"]

app = Typer()
app.command()(simulate_command)


@pytest.fixture
def cubes(tmp_path) -> list[str]:
    paths = []
    for name, edge in (("lower", 0.2), ("upper", 0.1)):
        paths.append(str(tmp_path / f"{name}.obj"))
        trimesh.creation.box((edge,) * 3).subdivide().export(paths[-1])
    return paths


@pytest.fixture
def field_file(tmp_path) -> str:
    corners = torch.tensor([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
    points = torch.stack([corners, corners + torch.tensor([0.15, 0.0, 0.0])])
    two = torch.ones(2)
    field = ConvexField(points, 200 * two, 2 * two, 0.9 * two, torch.zeros(2, 4, 3))
    write_ply(field, tmp_path / "field.ply")
    return str(tmp_path / "field.ply")


def settings(*more: str) -> list[str]:
    return [part for s in (*QUICK, *more) for part in ("--set", s)]


def test_several_objects_land_on_each_other(cubes, tmp_path):
    out = tmp_path / "played"
    low = settings("object.drop_height=0.005", "2:material.density=500", "time.frames=5", "basis.mesher=lattice")
    result = CliRunner().invoke(app, [*cubes, "--out", str(out), "--json", *low])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["objects"] == 2 and summary["mass_kg"] == pytest.approx(8.0 + 0.5, rel=1e-3)
    with np.load(out / "trajectory.npz") as arrays:
        positions, owners = arrays["positions"], arrays["owners"]
        assert arrays["handles_0"].shape == arrays["handles_1"].shape == (5, 3, 3, 4)
    rest = [positions[0, owners == k, 2] for k in (0, 1)]
    assert rest[0].min() == pytest.approx(0.005) and rest[1].min() == pytest.approx(rest[0].max() + 0.005)
    end = [positions[-1, owners == k, 2].mean() for k in (0, 1)]
    assert end[0] == pytest.approx(0.1, abs=0.01)
    assert end[1] == pytest.approx(0.25, abs=0.01)  # free fall would have taken it 0.13 m down


def test_a_convex_field_moves_with_its_body(field_file, tmp_path):
    out = tmp_path / "played"
    turn = settings(
        "object.drop_height=0.05",  # lands after 0.10 of 0.125 s
        "object.size=0.5",
        "object.angular_velocity=[0,2,0]",
        "time.frames=4",
        "basis.max_nodes=200",
        "basis.mesher=lattice",  # the other one does not repeat itself
        "convexes.limit=0",
    )
    result = CliRunner().invoke(app, [field_file, "--out", str(out), "--video", "--json", *turn])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["mass_kg"] == pytest.approx(1000 * 0.5 * (4 / 7 * 0.5) ** 2, rel=0.01)
    fields = [read_ply(path) for path in sorted((out / "convexes").iterdir())]
    assert len(fields) == 4 and read_video(out / "video.mp4").frames.std() > 5
    with np.load(out / "half_spaces.npz") as arrays:
        normals, offsets = arrays["normals"], arrays["offsets"]
    fall = -(fields[-1].centres - fields[0].centres)[:, 2].mean()
    assert 0.026 < fall < 0.0766  # what a rebound without loss leaves, and free fall
    for frame, tolerance in ((0, 1e-5), (3, 0.01)):
        # every plane carries its face: no vertex lies outside, and some lie on it
        points = np.broadcast_to(fields[frame].points.numpy()[:, None], (*offsets.shape[1:], 8, 3))
        there = np.isfinite(offsets[frame])
        gap = np.einsum("pi,pki->pk", normals[frame][there], points[there]) - offsets[frame][there][:, None]
        assert gap.max() < tolerance and np.abs(gap).min(axis=1).max() < tolerance
    expected = half_spaces(fields[0])
    np.testing.assert_allclose(np.sort(offsets[0]), np.sort(expected.offsets.numpy()), atol=1e-5)


def test_flat_convexes_alone_are_no_body(tmp_path):
    ones = torch.ones(2)
    triangles = torch.as_tensor(np.random.default_rng(0).normal(size=(2, 3, 3)), dtype=torch.float32)
    write_ply(ConvexField(triangles, 200 * ones, 2 * ones, ones, torch.zeros(2, 4, 3)), tmp_path / "field.ply")
    with pytest.raises(InputError, match=r"fill no cell .* folder of the reconstruction"):
        play(read_asset(tmp_path / "field.ply"), load_play_config(overrides=QUICK))


@pytest.mark.parametrize("count", [1, 3000])
def test_a_field_of_one_convex_and_of_thousands_is_one_body(count, tmp_path):
    """Overlapping hulls all over a box: one closed surface around them is meshed, not the hulls."""
    corners = 0.5 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    places = np.random.default_rng(0).uniform(-0.1, 0.1, (count, 1, 3)) if count > 1 else np.zeros((1, 1, 3))
    points = torch.as_tensor(corners * (0.04 if count > 1 else [0.3, 0.2, 0.1]) + places, dtype=torch.float32)
    ones = torch.ones(count)
    write_ply(ConvexField(points, 200 * ones, 2 * ones, ones, torch.zeros(count, 4, 3)), tmp_path / "field.ply")
    config = load_play_config(overrides=[*QUICK, "basis.max_nodes=300"])
    played = play(read_asset(tmp_path / "field.ply"), config)
    box, rounded = (0.3 * 0.2 * 0.1, 1.0) if count == 1 else (0.24**3, 0.94)  # few of 3,000 reach its edges
    assert played.volume == pytest.approx(rounded * box, rel=0.02) and len(played.trajectories) == 1


def test_a_reconstruction_moves_as_its_closed_surface_and_takes_the_field_along(field_file, tmp_path):
    folder, out = tmp_path / "reconstruction", tmp_path / "played"
    folder.mkdir()
    write_ply(read_ply(field_file), folder / "field.ply")
    trimesh.creation.box((0.35, 0.2, 0.2)).apply_translation((0.075, 0, 0)).export(folder / "body.ply")
    (folder / "reconstruction.json").write_text("{}")
    fast = settings("object.drop_height=0.2", "time.frames=4", "basis.mesher=lattice")
    result = CliRunner().invoke(app, [str(folder), "--out", str(out), "--json", *fast])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["mass_kg"] == pytest.approx(1000 * 0.35 * 0.2 * 0.2, rel=0.01)
    with np.load(out / "trajectory.npz") as arrays:
        positions = arrays["positions"]
    assert len(positions[0]) == 8 and positions[0, :, 2].min() == pytest.approx(0.2)
    fields = [read_ply(path) for path in sorted((out / "convexes").iterdir())]
    falls = (positions[0] - positions[-1])[:, 2].mean(), (fields[0].centres - fields[-1].centres)[:, 2].mean()
    assert falls[1].item() == pytest.approx(falls[0], rel=1e-4)  # the field goes with the body
    assert falls[0] == pytest.approx(0.5 * 9.81 * 0.125**2, rel=0.02)  # of few time steps


def test_convexes_that_the_motion_bends_are_split(tmp_path):
    """A long bar of two convexes that falls flat on a floor, on one end first, and so is bent."""
    corners = torch.tensor([[x, y, z] for x in (-0.15, 0.15) for y in (-0.03, 0.03) for z in (-0.03, 0.03)])
    points = torch.stack([corners, corners + torch.tensor([0.3, 0.0, 0.0])])
    two = torch.ones(2)
    write_ply(ConvexField(points, 200 * two, 2 * two, 0.9 * two, torch.zeros(2, 4, 3)), tmp_path / "bar.ply")
    fall = [
        "material.youngs_modulus=2.0e4",
        "object.drop_height=0.001",
        "object.angular_velocity=[0,4,0]",
        "object.velocity=[0,0,-2]",
        "time.frames=4",
        "time.fps=60",
        "convexes.deviation=0.002",
        "basis.modes=4",
        "basis.max_nodes=300",
        "basis.mesher=lattice",
    ]
    found = {}
    for name, more in (("split", ()), ("whole", ("convexes.limit=0",))):
        out = tmp_path / name
        result = CliRunner().invoke(app, [str(tmp_path / "bar.ply"), "--out", str(out), *settings(*fall, *more)])
        assert result.exit_code == 0, result.output
        assert ("convexes that the motion bends are split: 2 become" in result.output) == (name == "split")
        (found[name],) = json.loads((out / "simulation.json").read_text())["summary"]["convexes"]
        assert len(read_ply(out / "convexes" / "000003.ply")) == found[name]["merged"]
    assert found["split"]["given"] == 2 < found["split"]["merged"] <= found["split"]["split"]
    assert found["split"]["off_affine_m"] < 0.5 * found["split"]["off_affine_given_m"]
    assert found["whole"]["merged"] == 2
    assert found["whole"]["off_affine_m"] == pytest.approx(found["split"]["off_affine_given_m"], rel=1e-3)


def test_a_refinement_brings_its_surface_and_material(cubes, tmp_path):
    surface, folder = read_surface(cubes[0]), tmp_path / "refined"
    folder.mkdir()
    np.savez(folder / "trajectory.npz", vertices=np.stack([surface.vertices + 1.0] * 2), faces=surface.faces)
    found = {
        "youngs_modulus": {"value": 2.5e4},
        "parameters": {"poisson_ratio": {"value": 0.31}, "log10_youngs_modulus": {"value": 4.4}},
        "fixed": {"damping_time": {"value": 0.0, "unit": "s"}},
    }
    (folder / "refinement.json").write_text(json.dumps(found))
    asset = read_asset(folder)
    config = load_play_config(overrides=[*QUICK, "basis.mesher=lattice"], found=asset.settings)
    material = config.material
    assert (material.youngs_modulus, material.poisson_ratio, material.damping_time) == (2.5e4, 0.31, 0.0)
    assert play(asset, config).mass == pytest.approx(8.0, rel=1e-3)
    assert load_play_config("stiff", found=asset.settings).material.youngs_modulus == 1e7
    with pytest.raises(InputError, match=r"expected a folder of `physconvex refine`"):
        read_asset(tmp_path)


def test_overrides_by_number():
    given = ["time.frames=3", "2:material.density=5", "1:object.size=2"]
    assert overrides_of(1, 2, given) == ["time.frames=3", "object.size=2"]
    assert overrides_of(2, 2, given) == ["time.frames=3", "material.density=5"]
    with pytest.raises(InputError, match="object 2 of 1"):
        overrides_of(1, 1, given)


def test_elastic_weights_can_be_chosen(cubes):
    config = load_play_config(overrides=[*QUICK, "basis.mesher=lattice", "basis.kind=elastic", "basis.modes=6"])
    played = play_together([read_surface(cubes[1])], [config])
    assert played.trajectory.handles().shape[1] == 7 and np.isfinite(played.positions).all()
