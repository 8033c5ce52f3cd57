"""Files that appear whole or not at all."""

import json

import pytest

from physconvex.io import whole_file, write_json


def test_a_file_that_could_not_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "state.json"
    write_json(path, {"step": 1, "name": "ä"})
    with pytest.raises(OSError, match="disk"), whole_file(path) as partial:
        assert partial.parent == tmp_path and partial.suffix == ".json"
        partial.write_text("half")
        raise OSError("the disk is full")
    assert json.loads(path.read_text(encoding="utf-8")) == {"step": 1, "name": "ä"}
    assert [file.name for file in tmp_path.iterdir()] == ["state.json"]


def test_json_holds_no_nan_unless_it_is_allowed(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"psnr": float("inf")})
    assert not list(tmp_path.iterdir())
    write_json(tmp_path / "a.json", {"psnr": float("inf")}, allow_nan=True)
    assert json.loads((tmp_path / "a.json").read_text()) == {"psnr": float("inf")}
