"""Folders of falls: the same bytes for the same seed, finished where they were cut off."""

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen import draw_falls, generate_falls, load_config, read_falls
from data_gen.commands import app
from data_gen.explicit.generate import load_bodies, save_bodies
from physconvex import ConvergenceError, InputError

CONFIG = load_config("training", overrides=["objects.simulations_per_object=2"])


@pytest.fixture(scope="module")
def falls():
    return draw_falls(CONFIG, 7, 3, nodes=300)


def test_falls_of_a_shape_share_it_and_nothing_else(falls):
    one, other = falls
    assert np.array_equal(one.corners, other.corners) and np.array_equal(one.tets, other.tets)
    assert one.youngs_modulus != other.youngs_modulus and not np.allclose(one.place, other.place)
    for body in falls:
        mesh = body.mesh()
        assert mesh.vertices[:, 2].min() > 0
        assert mesh.size == pytest.approx(body.size, rel=0.1)  # also what was scaled otherwise than the first
        assert 20 < len(mesh.vertices) <= 300


def test_what_is_written_can_be_read(falls, tmp_path):
    save_bodies(tmp_path / "falls-0000.npz", [falls], drawn=(0, 1))
    for one, other in zip(load_bodies(tmp_path / "falls-0000.npz"), falls, strict=True):
        for name, value in vars(other).items():
            assert np.array_equal(getattr(one, name), value), name


def test_a_file_without_falls_is_an_error(tmp_path):
    with pytest.raises(ConvergenceError, match="none of the shapes 0 to 4"):
        save_bodies(tmp_path / "falls-0000.npz", [], drawn=(0, 5))


def test_a_run_goes_on_and_gives_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr("data_gen.explicit.generate.SHAPES", 1)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    done: list[int] = []
    assert generate_falls(whole, shapes=2, config=CONFIG, seed=3, nodes=200, on_file=done.append) == 4
    assert done == [1, 2]
    monkeypatch.setattr("data_gen.explicit.generate.run_tasks", lambda function, tasks, _: map(function, tasks))
    assert generate_falls(cut, shapes=1, config=CONFIG, seed=3, nodes=200) == 2
    assert generate_falls(cut, shapes=2, config=CONFIG, seed=3, nodes=200) == 4
    for path in whole.glob("*.npz"):
        assert path.read_bytes() == (cut / path.name).read_bytes()
    with pytest.raises(InputError, match="begun with another seed"):
        generate_falls(cut, shapes=2, config=CONFIG, seed=4, nodes=200)


def test_bad_arguments_are_named(tmp_path):
    with pytest.raises(InputError, match=r"nodes: got 3000; expected 20 to 2048"):
        generate_falls(tmp_path, shapes=1, config=CONFIG, nodes=3000)
    with pytest.raises(InputError, match="shapes: got 0"):
        generate_falls(tmp_path, shapes=0, config=CONFIG)
    with pytest.raises(InputError, match="holds no falls"):
        read_falls(tmp_path)
    with pytest.raises(InputError, match=r"video.fps: got \(0.0, 0.0, -9.81\), 30.0; expected"):
        draw_falls(load_config("training", overrides=["video.fps=30"]), 0, 0)
    with pytest.raises(InputError, match="procedural"):
        draw_falls(load_config("training", overrides=["objects.folder=meshes"]), 0, 0)


def test_the_command(tmp_path):
    result = CliRunner().invoke(
        app,
        ["falls", "--out", str(tmp_path / "falls"), "--shapes", "1", "--each", "1", "--nodes", "200", "--workers", "1"],
    )
    assert result.exit_code == 0, result.output
    assert "1 falls" in result.output
