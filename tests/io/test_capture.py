"""Capture folders: what is written is read again, and each mistake in one is named."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from physconvex import InputError
from physconvex.io import (
    Boundary,
    Camera,
    Capture,
    CaptureFile,
    Floor,
    Tracks,
    VideoError,
    capture_schema,
    load_capture,
    look_at,
    save_capture,
    write_video,
)
from physconvex.mesh import TetMesh

FRAMES, WIDTH, HEIGHT = 6, 64, 48


def _camera(name: str, x: float = 0.0) -> Camera:
    return look_at((x, -3.0, 1.0), (0, 0, 0.5), width=WIDTH, height=HEIGHT, vertical_field_of_view=0.6, name=name)


def _capture(folder: Path, **changes: Any) -> Capture:
    cameras = (_camera("front"), _camera("side", 1.0))
    values: dict[str, Any] = {"fps": 30.0, "frames": FRAMES, "observed_frames": 4, "cameras": cameras}
    return Capture(folder=folder, **(values | changes))


def _frames() -> tuple[np.ndarray, np.ndarray]:
    """A bright square that moves over grey, and where it is."""
    images = np.full((FRAMES, HEIGHT, WIDTH, 3), 90, np.uint8)
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    for k in range(FRAMES):
        mask[k, 7 + 3 * k : 19 + 3 * k, 20:37] = True
    images[mask] = (230, 200, 40)
    return images, mask


def _tets() -> TetMesh:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=np.float64)
    return TetMesh(corners, np.array([[0, 1, 2, 3], [1, 4, 2, 3]]))


def _tracks() -> Tracks:
    rest = np.random.default_rng(0).normal(size=(5, 3))
    positions = rest + np.linspace(0, 1, FRAMES)[:, None, None] * [0, 0, -1.0]
    positions[2, 3] = np.nan
    return Tracks(rest=rest, positions=positions, sigma=np.full((FRAMES, 5), 0.002))


def test_whole_capture_round_trip(tmp_path: Path) -> None:
    images, mask = _frames()
    written = _capture(
        tmp_path / "capture",
        gravity=np.array([0.1, 0.0, -9.8]),
        density=950.0,
        floor=Floor(point=np.array([0, 0, 0.1]), normal=np.array([0, 0, 2.0]), friction=0.4),
        initial_velocity=np.array([0.5, 0, 0]),
        initial_angular_velocity=np.array([0, 1.0, 0]),
    )
    box = trimesh.creation.box(extents=(0.3, 0.5, 0.2))
    boundary = Boundary(clamped_vertices=np.array([0, 4]), motion=np.zeros((FRAMES, 2, 3)))
    save_capture(
        written,
        videos={"front": images, "side": images[:, :, ::-1]},
        masks={"front": mask, "side": mask[:, :, ::-1]},
        mesh=box,
        tets=_tets(),
        tracks=_tracks(),
        boundary=boundary,
        truth={"youngs_modulus": 1e5},
        crf=4,
    )
    capture = load_capture(tmp_path / "capture")
    for name in ("fps", "frames", "observed_frames", "density"):
        assert getattr(capture, name) == getattr(written, name), name
    for name in ("gravity", "initial_velocity", "initial_angular_velocity"):
        np.testing.assert_array_equal(getattr(capture, name), getattr(written, name))
    assert capture.floor is not None and capture.floor.friction == 0.4
    np.testing.assert_allclose(capture.floor.normal, [0, 0, 1])
    assert [camera.name for camera in capture.cameras] == ["front", "side"]
    np.testing.assert_allclose(capture.camera("side").transform_matrix, written.cameras[1].transform_matrix)
    video, silhouettes = capture.video("side"), capture.mask("side")
    assert np.abs(video.frames.astype(int) - images[:, :, ::-1]).mean() < 4
    assert silhouettes is not None
    np.testing.assert_array_equal(silhouettes, mask[:, :, ::-1])
    assert capture.object_size == pytest.approx(0.5)
    mesh, tets, tracks, again = capture.mesh(), capture.tets(), capture.tracks(), capture.boundary()
    assert mesh is not None and tets is not None and tracks is not None and again is not None
    np.testing.assert_allclose(mesh.vertices, box.vertices, atol=1e-7)  # same order
    np.testing.assert_array_equal(mesh.faces, box.faces)
    np.testing.assert_array_equal(tets.tets, _tets().tets)
    np.testing.assert_array_equal(tracks.positions, _tracks().positions)
    np.testing.assert_array_equal(again.clamped_vertices, [0, 4])
    assert json.loads((tmp_path / "capture/truth.json").read_text()) == {"youngs_modulus": 1e5}


def test_defaults_of_a_minimal_capture(tmp_path: Path) -> None:
    (tmp_path / "capture.json").write_text('{"fps": 24, "frames": 10}')
    for path in (tmp_path, tmp_path / "capture.json"):
        capture = load_capture(path)
        assert (capture.fps, capture.frames, capture.observed_frames, capture.density) == (24.0, 10, 10, 1000.0)
        np.testing.assert_array_equal(capture.gravity, [0, 0, -9.81])
        assert capture.floor is None and capture.initial_velocity is None and capture.cameras == ()
        assert capture.mesh() is None and capture.tets() is None
        assert capture.tracks() is None and capture.boundary() is None and capture.object_size is None
        np.testing.assert_allclose(capture.times, np.arange(10) / 24)


def test_times_come_from_the_capture_and_extra_frames_are_left_out(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c"))
    images, _ = _frames()
    write_video(tmp_path / "c/front.mp4", np.concatenate([images, images]), fps=60.0)
    video = load_capture(tmp_path / "c").video("front")
    assert (len(video.frames), video.fps) == (FRAMES, 30.0)
    np.testing.assert_allclose(video.timestamps, np.arange(FRAMES) / 30)


def test_image_folder_with_alpha(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c"))
    images, mask = _frames()
    (tmp_path / "c/front").mkdir()
    for k in range(FRAMES):
        Image.fromarray(np.dstack([images[k], mask[k] * np.uint8(255)])).save(tmp_path / f"c/front/{k:06d}.png")
    capture = load_capture(tmp_path / "c")
    np.testing.assert_array_equal(capture.video("front").frames, images)
    np.testing.assert_array_equal(capture.mask("front"), mask)


def test_pictures_of_frame_0_alone(tmp_path: Path) -> None:
    images, mask = _frames()
    rgba = np.dstack([images[0], mask[0] * np.uint8(200)])
    written = _capture(tmp_path / "c", cameras=(*_capture(tmp_path).cameras, _camera("back")))
    save_capture(
        written,
        videos={"front": images},
        stills={"side": images[0], "back": rgba},
        masks={"front": mask, "side": mask[0]},
    )
    names = {path.name for path in (tmp_path / "c").iterdir()}
    assert names == {"capture.json", "front.mp4", "front_mask.mp4", "side.png", "side_mask.png", "back.png"}
    capture = load_capture(tmp_path / "c")
    assert [camera.name for camera in capture.recorded] == ["front"] and len(capture.pictured) == 3
    for name in ("side", "back"):
        np.testing.assert_array_equal(capture.first_frame(name)[0], images[0])
    np.testing.assert_array_equal(capture.first_frame("back")[1], rgba[..., 3])
    np.testing.assert_array_equal(capture.first_mask("side"), mask[0])
    np.testing.assert_array_equal(capture.first_mask("front"), mask[0])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"stills": {"side": np.zeros((HEIGHT, 60, 3), np.uint8)}}, r"stills\['side'\]: got shape \(48, 60, 3\)"),
        ({"stills": {"side": np.zeros((HEIGHT, WIDTH, 1), np.uint8)}}, r"expected \(48, 64, 3\)"),
        ({"stills": {"side": np.zeros((HEIGHT, WIDTH, 3))}}, r"stills\['side'\]: got float64; expected uint8"),
        ({"masks": {"side": np.zeros((HEIGHT, 60), bool)}}, r"masks\['side'\]: got shape"),
    ],
)
def test_stills_that_do_not_fit(tmp_path: Path, change: dict[str, Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        save_capture(_capture(tmp_path / "c"), **change)
    assert list(tmp_path.iterdir()) == []


def test_masks_are_true_or_false(tmp_path: Path) -> None:
    _, mask = _frames()
    with pytest.raises(InputError, match=r"masks\['front'\]: got uint8; expected bool"):
        save_capture(_capture(tmp_path / "c"), masks={"front": mask * np.uint8(255)}, tracks=_tracks())


def test_video_without_mask_has_none(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c"), videos={"front": _frames()[0]})
    assert load_capture(tmp_path / "c").mask("front") is None


def test_size_from_tetrahedra_where_there_is_no_mesh(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c"), tets=_tets())
    assert load_capture(tmp_path / "c").object_size == pytest.approx(1.0)


def test_one_sigma_for_all_tracks(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c"))
    tracks = _tracks()
    np.savez(tmp_path / "c/tracks.npz", rest=tracks.rest, positions=tracks.positions, sigma=0.003)
    again = load_capture(tmp_path / "c").tracks()
    assert again is not None
    np.testing.assert_array_equal(again.sigma, np.full((FRAMES, 5), 0.003))


def test_reading_does_not_touch_the_truth(tmp_path: Path) -> None:
    images, mask = _frames()
    save_capture(_capture(tmp_path / "c"), videos={"front": images}, masks={"front": mask}, tracks=_tracks())
    (tmp_path / "c/truth.json").mkdir()  # opening it as a file would fail
    capture = load_capture(tmp_path / "c")
    capture.video("front"), capture.mask("front"), capture.tracks(), capture.object_size


def test_reading_loads_no_torch(tmp_path: Path) -> None:
    (tmp_path / "capture.json").write_text('{"fps": 24, "frames": 10}')
    code = (
        "import sys; from physconvex.io import load_capture; "
        f"load_capture({str(tmp_path)!r}).object_size; sys.exit('torch' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# Mistakes


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"fps": 0}, "fps: got 0, expected a positive number"),
        ({"fps": "24"}, "fps: got '24'"),
        ({"fps": None}, "fps: got None"),
        ({"frames": 2.5}, "frames: got 2.5, expected a whole number"),
        ({"frames": True}, "frames: got True"),
        ({"observed_frames": 7}, "observed_frames: got 7, expected 1 to frames = 6"),
        ({"gravity": [0, 0]}, r"gravity: got \[0, 0\], expected three numbers"),
        ({"gravity": "down"}, "gravity: got 'down'"),
        ({"gravity": [0, 0, float("nan")]}, "gravity: got"),
        ({"density": -1}, "density: got -1, expected a positive number"),
        ({"floor": 0}, "floor: got 0, expected an object"),
        ({"floor": {"point": [0, 0, 0]}}, "floor.normal: got nothing, expected three numbers"),
        ({"floor": {"point": [0, 0, 0], "normal": [0, 0, 0]}}, "not zero"),
        ({"floor": {"point": [0, 0, 0], "normal": [0, 0, 1], "friction": -1}}, "floor.friction: got -1"),
        ({"floor": {"point": [0, 0, 0], "normal": [0, 0, 1], "frction": 1}}, "did you mean 'friction'"),
        ({"initial_velocty": [0, 0, 0]}, "did you mean 'initial_velocity'"),
        ({"cameras": {}}, "cameras: got {}, expected a list of objects"),
        ({"cameras": [{"name": "front"}]}, "missing w, h"),
    ],
)
def test_wrong_field_is_named(tmp_path: Path, change: dict[str, Any], match: str) -> None:
    content = {"fps": 24.0, "frames": 6} | change
    (tmp_path / "capture.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=match) as caught:
        load_capture(tmp_path)
    assert str(caught.value).startswith(str(tmp_path / "capture.json"))


def test_missing_field_is_named(tmp_path: Path) -> None:
    (tmp_path / "capture.json").write_text('{"fps": 24}')
    with pytest.raises(InputError, match="frames: got nothing"):
        load_capture(tmp_path)


@pytest.mark.parametrize(
    ("text", "match"), [("{", "not valid JSON"), ("[1]", "holds a list"), (None, "no such file"), ("\xff", "JSON")]
)
def test_unreadable_metadata(tmp_path: Path, text: str | None, match: str) -> None:
    if text is not None:
        (tmp_path / "capture.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=match):
        load_capture(tmp_path)


@pytest.mark.parametrize("name", ["", "..", "a/b", "front_mask"])
def test_camera_names_must_name_files(tmp_path: Path, name: str) -> None:
    camera = look_at((0, -3, 1), (0, 0, 0), width=8, height=8, vertical_field_of_view=0.6, name=name)
    with pytest.raises(InputError, match="cannot name a file"):
        _capture(tmp_path, cameras=(camera,))


def test_camera_names_must_differ(tmp_path: Path) -> None:
    camera = _capture(tmp_path).cameras[0]
    with pytest.raises(InputError, match="each once"):
        _capture(tmp_path, cameras=(camera, camera))


def test_videos_that_do_not_fit(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c"))
    capture, (images, _) = load_capture(tmp_path / "c"), _frames()
    with pytest.raises(InputError, match="expected one of"):
        capture.video("back")
    with pytest.raises(InputError, match="no such file, nor a folder"):
        capture.video("front")
    write_video(tmp_path / "c/front.mp4", images[:, :40], fps=30.0)
    with pytest.raises(InputError, match=r"64x40 pixels, capture.json says 64x48"):
        capture.video("front")
    write_video(tmp_path / "c/front.mp4", images[:5], fps=30.0)
    with pytest.raises(InputError, match=r"5 frames, capture.json says 6"):
        capture.video("front")
    (tmp_path / "c/front.mp4").write_text("no video")
    with pytest.raises(VideoError):
        capture.video("front")


def _write(name: str, **arrays: Any) -> Callable[[Path], None]:
    return lambda folder: np.savez(folder / name, **arrays)


@pytest.mark.parametrize(
    ("part", "write", "match"),
    [
        ("tracks", _write("tracks.npz", rest=np.zeros((5, 3))), "expected also"),
        ("tracks", _write("tracks.npz", rest=np.zeros((5, 2)), positions=np.zeros((6, 5, 3)), sigma=1.0), "rest"),
        ("tracks", _write("tracks.npz", rest=np.zeros((5, 3)), positions=np.zeros((6, 4, 3)), sigma=1.0), "positions"),
        ("tracks", _write("tracks.npz", rest=np.zeros((5, 3)), positions=np.zeros((7, 5, 3)), sigma=1.0), "7 frames"),
        ("tracks", _write("tracks.npz", rest=np.zeros((5, 3)), positions=np.zeros((6, 5, 3)), sigma=0.0), "sigma"),
        ("tracks", lambda folder: (folder / "tracks.npz").write_text("text"), "not a readable npz"),
        ("tets", _write("tets.npz", vertices=np.zeros((4, 3)), tets=[[0, 1, 2, 3]]), "no positive volume"),
        ("boundary", _write("boundary.npz", other=[1]), "either clamped_vertices or clamped_box"),
        ("boundary", _write("boundary.npz", clamped_vertices=[0.5]), "integer"),
        ("boundary", _write("boundary.npz", clamped_box=[[1.0, 0, 0], [0, 0, 0]]), "clamped_box"),
        ("boundary", _write("boundary.npz", clamped_vertices=[0, 1], motion=np.zeros((6, 3, 3))), "motion"),
        ("boundary", _write("boundary.npz", clamped_vertices=[0], motion=np.zeros((5, 1, 3))), "5 frames"),
        ("mesh", lambda folder: (folder / "mesh.ply").write_text("text"), "not a readable mesh"),
        ("mesh", lambda folder: (folder / "mesh.obj").write_text("v 0 0 0\n"), "mesh.obj"),
    ],
)
def test_broken_parts_are_named(tmp_path: Path, part: str, write: Callable[[Path], None], match: str) -> None:
    save_capture(_capture(tmp_path / "c"))
    write(tmp_path / "c")
    with pytest.raises(InputError, match=match):
        getattr(load_capture(tmp_path / "c"), part)()


def test_two_meshes_are_refused(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c"), mesh=trimesh.creation.box())
    (tmp_path / "c/mesh.ply").write_bytes(trimesh.creation.box().export(file_type="ply"))
    with pytest.raises(InputError, match="expected one mesh"):
        load_capture(tmp_path / "c").mesh()


def test_saving_refuses_what_does_not_fit_and_leaves_nothing(tmp_path: Path) -> None:
    images, _ = _frames()
    with pytest.raises(InputError, match=r"videos\['front'\]: got shape"):
        save_capture(_capture(tmp_path / "c"), videos={"front": images[:3]})
    with pytest.raises(InputError, match="expected one of"):
        save_capture(_capture(tmp_path / "c"), videos={"back": images})
    with pytest.raises(InputError, match="uint8"):
        save_capture(_capture(tmp_path / "c"), videos={"front": images.astype(np.float32)})
    assert list(tmp_path.iterdir()) == []
    save_capture(_capture(tmp_path / "c"))
    with pytest.raises(InputError, match="exists"):
        save_capture(_capture(tmp_path / "c"))
    assert [path.name for path in tmp_path.iterdir()] == ["c"]


def test_the_schema_describes_every_field() -> None:
    schema = capture_schema()
    assert schema["required"] == ["fps", "frames"]
    fields = schema["properties"]
    assert set(fields) == set(CaptureFile.model_fields)
    assert all("description" in field for field in fields.values())
    assert fields["gravity"]["default"] == [0.0, 0.0, -9.81] and "[m/s²]" in fields["gravity"]["description"]
    camera = schema["$defs"]["CameraEntry"]
    assert camera["required"] == ["name", "w", "h", "fl_x", "fl_y", "cx", "cy", "transform_matrix"]
    assert all("description" in field for field in camera["properties"].values())


def test_what_is_written_obeys_the_schema(tmp_path: Path) -> None:
    save_capture(_capture(tmp_path / "c", floor=Floor(np.zeros(3), np.array([0, 0, 1.0]))))
    written = json.loads((tmp_path / "c/capture.json").read_text())
    assert set(written) <= set(capture_schema()["properties"])
    assert CaptureFile.model_validate_json((tmp_path / "c/capture.json").read_text()).frames == FRAMES
