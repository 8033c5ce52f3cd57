"""Stages of a refinement on disk."""

import numpy as np

from inference import Stages


def test_a_stage_that_was_cut_short_is_made_anew(tmp_path):
    calls = []

    def compute():
        calls.append(1)
        return {"values": np.arange(1000.0)}

    assert len(Stages(tmp_path, "key").run("one", compute)["values"]) == 1000
    np.testing.assert_array_equal(Stages(tmp_path, "key").run("one", compute)["values"], np.arange(1000.0))
    assert len(calls) == 1
    file = tmp_path / "stages" / "one.npz"
    file.write_bytes(file.read_bytes()[:200])  # a zip archive without its end
    np.testing.assert_array_equal(Stages(tmp_path, "key").run("one", compute)["values"], np.arange(1000.0))
    assert len(calls) == 2
    Stages(tmp_path, "other key").run("one", compute)
    assert len(calls) == 3
