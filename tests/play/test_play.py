"""`physconvex simulate`: from a mesh file to its motion on disk."""

import json

import numpy as np
import pytest
import trimesh
from typer import Typer
from typer.testing import CliRunner

from inference.simulation_command import simulate_command
from physconvex import InputError, simulate
from physconvex.io import read_video
from physconvex.io.configuration import preset_names
from physconvex.play import PlayConfig, load_play_config, play, read_surface
from physconvex.reduced import SkinningField, predicted_weights

QUICK = ["basis.max_nodes=150", "basis.modes=2", "time.frames=3", "time.steps_per_frame=4", "basis.mesher=lattice"]

app = Typer()
app.command()(simulate_command)


@pytest.fixture
def ball(tmp_path) -> str:
    path = tmp_path / "ball.obj"
    trimesh.creation.icosphere(subdivisions=2, radius=0.1).export(path)
    return str(path)


def invoke(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def test_the_command_writes_trajectory_frames_and_summary(ball, tmp_path):
    out = tmp_path / "played"
    settings = [part for s in QUICK for part in ("--set", s)]
    result = invoke(
        ball,
        "--out",
        str(out),
        "--preset",
        "soft",
        "--drop-height",
        "0.3",
        "--size",
        "0.4",
        "--json",
        "--video",
        *settings,
    )
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    # a ball of radius 0.2 m and 1000 kg/m³
    assert summary["frames"] == 3 and summary["mass_kg"] == pytest.approx(33.5, rel=0.05)
    with np.load(out / "trajectory.npz") as arrays:
        positions, times, rest = arrays["positions"], arrays["times"], arrays["rest"]
        assert arrays["handles"].shape == (3, 3, 3, 4)
    np.testing.assert_allclose(times, np.arange(3) / 24)
    np.testing.assert_allclose(positions[0], rest, atol=1e-9)
    assert rest[:, 2].min() == pytest.approx(0.3) and np.ptp(rest, axis=0).max() == pytest.approx(0.4)
    fall = positions[:, :, 2].mean(1)
    # free fall; the first step of BDF2 is implicit: up to 0.75 g h² more
    np.testing.assert_allclose(fall[0] - fall, 9.81 / 2 * times**2, atol=9.81 / 96**2)
    frames = sorted((out / "frames").iterdir())
    assert [f.name for f in frames] == ["000000.ply", "000001.ply", "000002.ply"]
    np.testing.assert_allclose(trimesh.load_mesh(frames[-1], process=False).vertices, positions[-1], atol=1e-6)
    assert read_video(out / "video.mp4").frames.shape == (3, 448, 448, 3)
    assert len(trimesh.load_mesh(out / "animation.glb", process=False).vertices) == len(rest)
    record = json.loads((out / "simulation.json").read_text())
    assert record["configuration"]["material"]["youngs_modulus"] == 8e3
    assert PlayConfig.model_validate(record["configuration"]) == load_play_config(
        "soft", overrides=["object.drop_height=0.3", "object.size=0.4", *QUICK]
    )


def test_the_function_does_what_the_command_does(ball, tmp_path):
    out = tmp_path / "played"
    played = simulate(ball, preset="soft", settings=[*QUICK, "object.drop_height=0.3"], out=out, ply=False)
    with np.load(out / "trajectory.npz") as arrays:
        np.testing.assert_array_equal(arrays["positions"], played.positions)
    assert (out / "animation.glb").exists() and not (out / "frames").exists()
    shown = played._repr_html_()
    assert f"1, {played.mass:.3g} kg" in shown and shown.count("data:image/png;base64,") == 1
    heavy = ["1:material.density=2000", *QUICK]
    pair = simulate([ball, ball], settings=heavy)
    assert pair.masses[0] == pytest.approx(2 * pair.masses[1])


def test_presets_are_what_their_names_say():
    configs = {name: load_play_config(name) for name in preset_names("physconvex.play")}
    assert set(configs) == {"stiff", "soft", "plasticine", "sand", "push", "moving_floor"}
    assert (configs["stiff"].material.youngs_modulus, configs["stiff"].material.poisson_ratio) == (1e7, 0.49)
    assert (configs["soft"].material.youngs_modulus, configs["soft"].material.poisson_ratio) == (8e3, 0.4)
    assert configs["plasticine"].material.yield_stress == 500.0
    assert configs["sand"].material.friction_angle_deg == 10.0
    assert configs["push"].forces.push[0] < 0
    floor = configs["moving_floor"].floor
    assert floor is not None and floor.velocity[0] > 0 and floor.period is not None


@pytest.mark.parametrize("name", ["stiff", "plasticine", "sand", "push", "moving_floor"])
def test_every_preset_plays(ball, name):
    low = ["object.drop_height=0.001", "time.frames=4"]
    played = play(read_surface(ball), load_play_config(name, overrides=[*QUICK, *low]))
    assert np.isfinite(played.positions).all() and played.positions[:, :, 2].min() > -0.01
    centre = played.positions[-1].mean(0)
    if name == "push":
        assert centre[0] < -0.01
    flowed = played.trajectory.flowed
    assert (flowed is not None) == (name in ("plasticine", "sand"))


def test_orientation_turns_the_object():
    bar = trimesh.creation.box((0.4, 0.2, 0.1))
    surface = load_surface(bar)
    config = load_play_config(overrides=["object.orientation_deg=[0,90,0]", "object.drop_height=0.25"]).object
    placed = surface.moved(*surface.placement(config))
    np.testing.assert_allclose(np.ptp(placed.vertices, axis=0), [0.1, 0.2, 0.4], atol=1e-12)
    assert placed.vertices[:, 2].min() == pytest.approx(0.25)


def test_areas_of_contact_points_add_up_whatever_their_number():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    surface = load_surface(ball)
    points, areas = surface.contact_points(10_000)
    np.testing.assert_array_equal(points, surface.vertices)
    assert areas.sum() == pytest.approx(ball.area)
    fewer, shares = surface.contact_points(40)
    assert len(fewer) == 40 and shares.sum() == pytest.approx(ball.area) and (shares > 0).all()
    # a uniform pressure has no resultant on a closed surface
    np.testing.assert_allclose(areas @ (points / 0.1), 0.0, atol=1e-12)


def load_surface(mesh):
    from physconvex.play import RestSurface

    return RestSurface(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def test_bad_input_names_what_is_wrong(ball, tmp_path):
    broken = tmp_path / "broken.obj"
    broken.write_text("nothing of a mesh")
    cases = {
        "absent.obj": (str(tmp_path / "absent.obj"),),
        "mesh": (str(broken),),
        "preset": (ball, "--preset", "jelly"),
        r"material\.yield_stress|yield_stress is missing": (ball, "--set", "material.kind=plasticine"),
        "poisson_ratio": (ball, "--poisson-ratio", "0.6"),
        "colour": (ball, "--set", "material.colour=red"),
        "--set": (ball, "--set", "material"),
    }
    for pattern, arguments in cases.items():
        result = invoke(*arguments, "--out", str(tmp_path / "none"))
        assert isinstance(result.exception, InputError), (pattern, result.exception)
        with pytest.raises(InputError, match=pattern):
            raise result.exception
    assert not (tmp_path / "none").exists()


@pytest.mark.wrong_types
def test_settings_that_are_no_list_are_refused(ball):
    with pytest.raises(InputError, match=r"settings: got {'material.density': 500}"):
        simulate(ball, settings={"material.density": 500})


@pytest.fixture
def field(tmp_path) -> SkinningField:
    """Three weights of a network of one hidden layer, stored for an object of 0.4 m."""
    shapes = {"weight_0": (8, 9), "bias_0": (8,), "weight_1": (3, 8), "bias_1": (3,)}
    rng = np.random.default_rng(4)
    tensors = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    made = SkinningField(tensors, object_size=0.4, harmonics=1)
    made.save(tmp_path / "toy.skinning.safetensors")
    return made


def test_predicted_weights_move_the_body_in_its_own_frame(field, tmp_path):
    """A bar of 0.2 m stands up on one end at twice its size: its points have the weights of the points in the file."""
    bar, file = trimesh.creation.box((0.2, 0.1, 0.05)), str(tmp_path / "toy.skinning.safetensors")
    bar.apply_translation((3.0, 0.0, 1.0))
    bar.export(tmp_path / "bar.obj")
    place = ["object.size=0.4", "object.orientation_deg=[0,-90,0]", "object.drop_height=0.1"]
    given = ["--basis", "predicted", "--basis-file", file]
    told = [part for s in [*QUICK, *place] for part in ("--set", s)]
    result = invoke(str(tmp_path / "bar.obj"), "--out", str(tmp_path / "out"), "--json", *given, *told)
    assert result.exit_code == 0, result.output
    chosen = ["basis.kind=predicted", f"basis.file={file}"]
    run = simulate(tmp_path / "bar.obj", settings=[*QUICK, *place, *chosen], out=None).trajectory
    with np.load(tmp_path / "out" / "trajectory.npz") as arrays:
        assert arrays["handles"].shape == (3, 4, 3, 4)  # M of the file, not of the settings
        np.testing.assert_allclose(arrays["handles"], run.handles(), atol=1e-6)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (9, 3)) * [0.4, 0.2, 0.1]
    turn = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])  # by -90 degrees about y
    placed = points @ turn.T + [0, 0, 0.1 + 0.2]
    expected = predicted_weights(field, origin=(0, 0, 0.3), rotation=turn)
    values, gradients = run.space.field.at(placed)
    np.testing.assert_allclose(values, field(points), atol=1e-5)
    np.testing.assert_allclose(gradients, expected.at(placed)[1], atol=1e-4)


def test_a_file_of_weights_that_is_missing_or_foreign_is_named(ball, field, tmp_path):
    other = tmp_path / "other.safetensors"
    other.write_text("no weights")
    cases = {
        "file is missing, which predicted weights need": ["--basis", "predicted"],
        "'predicted'": ["--basis-file", str(other)],
        "no skinning field at": ["--basis", "predicted", "--basis-file", str(tmp_path / "absent")],
        "other.safetensors' is no safetensors file": ["--basis", "predicted", "--basis-file", str(other)],
    }
    for pattern, arguments in cases.items():
        result = invoke(ball, "--out", str(tmp_path / "none"), *arguments)
        assert isinstance(result.exception, InputError), (pattern, result.exception)
        with pytest.raises(InputError, match=pattern):
            raise result.exception
