"""The data-set format: round trip, checksums, half-written folders, and whose folder it is."""

import json

import numpy as np
import pytest

from data_gen import Dataset
from data_gen.dataset import (
    RenderedView,
    finish_dataset,
    is_settled,
    simulation_folder,
    write_claim,
    write_given_up,
    write_simulation,
)
from data_gen.simulate import Samples
from physconvex import InputError
from physconvex.io import look_at, write_video

CAMERA = look_at((0, -4, 1), (0, 0, 0.5), width=64, height=48, vertical_field_of_view=0.7)
MASK = np.random.default_rng(0).random((3, 48, 63)) < 0.3
SAMPLES = Samples(
    points=np.arange(12.0).reshape(4, 3),
    volume_weights=np.full(4, 0.25),
    displacements=np.random.default_rng(1).normal(size=(3, 4, 3)),
    modes=np.eye(4)[:, :2],
    eigenvalues=np.array([1.0, 2.0]),
)


def write(root, number: int, *, split="train", failures=(), video=b"no video"):
    metadata = {
        "simulation": number,
        "object_id": f"blob-{number}",
        "split": split,
        "youngs_modulus": 1e5 * (number + 1),
        "initial_velocity": [0.0, 1.0, 2.0],
        "solver": {"steps": 7},
        "failures": list(failures),
    }
    view = RenderedView(video, MASK, {"camera": CAMERA.to_json(), "degradation": {"noise": 0.01}})
    write_simulation(root, number, metadata, SAMPLES, [view, view])


@pytest.fixture
def root(tmp_path):
    write(tmp_path, 0)
    write(tmp_path, 1, split="test", failures=["attempt 0: too thin"])
    finish_dataset(tmp_path, {"video": {}}, 5, "1.2.3")
    return tmp_path


def test_what_is_written_can_be_read(root):
    dataset = Dataset.open(root)
    assert [clip.clip_id for clip in dataset.clips] == ["000000_0", "000000_1", "000001_0", "000001_1"]
    clip = dataset.clips[3]
    assert clip.row["youngs_modulus"] == 2e5
    assert clip.row["solver_steps"] == 7 and clip.row["view_degradation_noise"] == 0.01
    assert json.loads(clip.row["initial_velocity"]) == [0, 1, 2]
    np.testing.assert_array_equal(clip.mask(), MASK)
    np.testing.assert_allclose(clip.samples().displacements, SAMPLES.displacements, rtol=1e-6)
    np.testing.assert_allclose(clip.camera.transform_matrix, CAMERA.transform_matrix)


def test_frames_come_from_the_stored_video(tmp_path):
    frames = np.full((3, 48, 64, 3), 90, np.uint8)
    write_video(tmp_path / "clip.mp4", frames, fps=24)
    write(tmp_path, 0, video=(tmp_path / "clip.mp4").read_bytes())
    finish_dataset(tmp_path, {}, 0, "1")
    np.testing.assert_allclose(Dataset.open(tmp_path).clips[0].frames(), frames, atol=2)


def test_a_split_holds_its_clips_alone(root):
    assert {clip.row["object_id"] for clip in Dataset.open(root, split="test").clips} == {"blob-1"}
    assert len(Dataset.open(root, split="validation")) == 0
    with pytest.raises(InputError, match="split"):
        Dataset.open(root, split="training")


@pytest.mark.parametrize("name", ["simulations/000001/view0.mp4", "simulations/000000/samples.npz", "index.parquet"])
def test_verify_notices_a_flipped_byte_and_a_missing_file(root, name):
    dataset = Dataset.open(root)
    assert dataset.verify() == []
    content = bytearray((root / name).read_bytes())
    content[len(content) // 2] ^= 1
    (root / name).write_bytes(content)
    assert dataset.verify() == [name]
    (root / name).unlink()
    assert dataset.verify() == [name]


def test_half_written_folders_are_ignored_and_overwritten(root):
    half = simulation_folder(root, 2).with_name(".partial-000002")
    half.mkdir()
    (half / "simulation.json").write_text("{")
    assert not is_settled(root, 2)
    finish_dataset(root, {}, 5, "1.2.3")
    assert len(Dataset.open(root)) == 4
    write(root, 2)
    assert not half.exists() and is_settled(root, 2)
    finish_dataset(root, {}, 5, "1.2.3")
    assert len(Dataset.open(root)) == 6


def test_manifest_counts_failed_attempts_and_names_what_was_given_up(root):
    write_given_up(root, 2, ["attempt 0: no", "attempt 1: no"])
    assert is_settled(root, 2)
    assert finish_dataset(root, {}, 5, "1.2.3") == (2,)
    manifest = Dataset.open(root).manifest
    assert manifest["simulations"] == 2 and manifest["failed_simulations"] == 3 and manifest["given_up"] == [2]
    assert manifest["failure_share"] == pytest.approx(3 / 5)
    notes = [json.loads(line) for line in (root / "failures.jsonl").read_text().splitlines()]
    assert [(note["simulation"], note["attempt"]) for note in notes] == [(1, 0), (2, 0), (2, 1)]


def test_finishing_twice_gives_the_same_bytes(root):
    before = (root / "manifest.json").read_bytes(), (root / "index.parquet").read_bytes()
    finish_dataset(root, {"video": {}}, 5, "1.2.3")
    assert ((root / "manifest.json").read_bytes(), (root / "index.parquet").read_bytes()) == before


def test_a_folder_of_another_configuration_is_refused(tmp_path):
    write_claim(tmp_path / "new", {"seed": 1, "configuration": {"a": 1}})
    write_claim(tmp_path / "new", {"seed": 1, "configuration": {"a": 1}})
    with pytest.raises(InputError, match="another configuration"):
        write_claim(tmp_path / "new", {"seed": 1, "configuration": {"a": 2}})
    with pytest.raises(InputError, match="another seed"):
        write_claim(tmp_path / "new", {"seed": 2, "configuration": {"a": 1}})


def test_folders_that_hold_no_data_set_are_named(tmp_path, root):
    with pytest.raises(InputError, match="manifest"):
        Dataset.open(tmp_path / "absent")
    manifest = json.loads((root / "manifest.json").read_text())
    (root / "manifest.json").write_text(json.dumps(manifest | {"format_version": 99}))
    with pytest.raises(InputError, match="format version 99"):
        Dataset.open(root)
    (tmp_path / "empty" / "simulations").mkdir(parents=True)
    with pytest.raises(InputError, match="no simulation succeeded"):
        finish_dataset(tmp_path / "empty", {}, 0, "1")
