"""Animated GLB and pictures of a played object."""

import json
import struct

import numpy as np
import pytest
import trimesh

from physconvex.play import FloorConfig, PlayConfig, frames_of, load_play_config, play, read_surface, write_animated_glb
from physconvex.play.pictures import floor_displacement

QUICK = ["basis.max_nodes=150", "basis.modes=2", "time.frames=4", "time.steps_per_frame=4", "basis.mesher=lattice"]


def chunks(path) -> tuple[dict, bytes]:
    """JSON and binary part of a GLB file."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def array(document: dict, data: bytes, number: int, columns: int) -> np.ndarray:
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    kind = np.float32 if accessor["componentType"] == 5126 else np.uint32
    part = data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.frombuffer(part, kind).reshape(accessor["count"], columns)


def test_every_frame_comes_back_from_the_animated_glb(tmp_path):
    rng = np.random.default_rng(0)
    sphere = trimesh.creation.icosphere(subdivisions=1)
    positions = np.asarray(sphere.vertices) + 0.1 * rng.normal(size=(3, len(sphere.vertices), 3))
    times, path = np.array([0.0, 0.1, 0.3]), tmp_path / "moving.glb"
    write_animated_glb(path, times, positions, np.asarray(sphere.faces))
    document, data = chunks(path)
    primitive = document["meshes"][0]["primitives"][0]
    base = array(document, data, primitive["attributes"]["POSITION"], 3)
    moved = [array(document, data, target["POSITION"], 3) for target in primitive["targets"]]
    sampler = document["animations"][0]["samplers"][0]
    weights = array(document, data, sampler["output"], 1).reshape(3, 2)
    np.testing.assert_allclose(array(document, data, sampler["input"], 1).ravel(), times, rtol=1e-6)
    for frame, shown in zip(positions, weights, strict=True):
        np.testing.assert_allclose(base + sum(w * m for w, m in zip(shown, moved, strict=True)), frame, atol=1e-6)
    still = trimesh.load_mesh(path, process=False)  # a reader that knows no animation sees the first frame, y up
    np.testing.assert_allclose(still.vertices, positions[0][:, [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    np.testing.assert_array_equal(still.faces, sphere.faces)


@pytest.mark.parametrize("period", [None, 0.7])
def test_the_drawn_floor_moves_as_the_simulated_one(period):
    floor = FloorConfig(velocity=(0.8, -0.2, 0.0), period=period)
    times = np.linspace(0, 0.5, 20001)
    speed = np.ones_like(times) if period is None else np.sin(2 * np.pi * times / period)
    expected = np.trapezoid(speed, times) * np.array(floor.velocity)
    np.testing.assert_allclose(floor_displacement(floor, 0.5), expected, atol=1e-8)


def test_pictures_show_the_object_falling_over_the_floor(tmp_path):
    path = tmp_path / "ball.obj"
    trimesh.creation.icosphere(subdivisions=2, radius=0.1).export(path)
    config: PlayConfig = load_play_config(None, overrides=[*QUICK, "object.drop_height=0.3"])
    pictures = list(frames_of(play(read_surface(path), config), size=128))
    assert len(pictures) == 4 and pictures[0].shape == (128, 128, 3)
    rows = []
    for picture in pictures:
        red, green, blue = picture.astype(int).transpose(2, 0, 1)
        painted = (red > green + 30) & (green > blue)  # the object alone is orange
        assert 50 < painted.sum() < 128 * 128 / 2
        rows.append(np.nonzero(painted)[0].mean())
    assert (np.diff(rows) > 0).all()  # downwards
