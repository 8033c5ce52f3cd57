"""The evaluation commands: numbers of a known predictor, files, figures."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import train.held_out
from models import ClipEstimate, PhysicsPredictor, PreparedClip
from physconvex import InputError
from physconvex.reduced import SkinningField
from train import TrainConfig, read_clips
from train.held_out import held_out
from train.options import EvaluationOptions
from train.predictor_evaluation import evaluate_predictor, write_predictor_report
from train.skinning_evaluation import evaluate_skinning, write_skinning_report


@pytest.fixture
def checkpoint(tiny_config: TrainConfig, tmp_path: Path) -> Path:
    PhysicsPredictor.from_config(tiny_config.network).save_pretrained(tmp_path / "checkpoint")
    return tmp_path / "checkpoint"


class Oracle(PhysicsPredictor):
    """Knows E to 0.1 decades from the size of the first frame's silhouette, if the frames are in order."""

    def __init__(self, known: dict[bytes, tuple[float, float]], config: object) -> None:
        self.known, self.config = known, config

    def estimate(self, clips: Sequence[PreparedClip], **_: object) -> list[ClipEstimate]:
        return [self._one(*self.known.get(clip.mask.tobytes(), (1e6, 0.3))) for clip in clips]

    def _one(self, modulus: float, poisson: float) -> ClipEstimate:
        return ClipEstimate(
            youngs_modulus=modulus * 10**0.1,
            poisson_ratio=poisson,
            log10_youngs_modulus_std=0.1,
            poisson_ratio_std=0.01,
            youngs_modulus_interval=(modulus * 10**-0.1, modulus * 10**0.2),
            poisson_ratio_interval=(poisson - 0.02, poisson - 0.01),
            dimensionless_log10_stiffness=0.0,
            skinning_field=SkinningField({}, 1.0, 1),
        )


def test_an_oracle_gets_its_score_and_loses_it_without_time(
    tiny_data: Path, tiny_cache: Path, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    predictor = PhysicsPredictor.from_pretrained(checkpoint)
    known = {}
    for clip in read_clips([tiny_data], "test"):
        prepared = predictor.prepare(clip.record.frames(), fps=clip.fps)
        known[prepared.mask.tobytes()] = (clip.youngs_modulus, clip.poisson_ratio)
    oracle = Oracle(known, predictor.config)
    known = type("P", (), {"from_pretrained": oracle_of(oracle)})
    monkeypatch.setattr(train.held_out, "PhysicsPredictor", known)
    options = EvaluationOptions(checkpoint="oracle", cache=tiny_cache, workers=0)
    result = evaluate_predictor([tiny_data], options, out=tmp_path)
    ordered, shuffled, frozen = result.readings
    assert ordered.log10_youngs_modulus.mae == pytest.approx(0.1, abs=1e-6)
    assert ordered.log10_youngs_modulus.coverage == 1.0 and ordered.poisson_ratio.coverage == 0.0
    assert ordered.poisson_ratio.mae == pytest.approx(0.0, abs=1e-9)
    assert min(shuffled.log10_youngs_modulus.mae, frozen.log10_youngs_modulus.mae) > 0.3
    assert sum(d.poisson_ratio.clips for d in ordered.decades) == 12
    truth = [np.log10(clip.youngs_modulus) for clip in read_clips([tiny_data], "test")]
    median = np.median([np.log10(clip.youngs_modulus) for clip in read_clips([tiny_data], "train")])
    assert ordered.log10_youngs_modulus.constant_mae == pytest.approx(np.abs(truth - median).mean())
    with pytest.raises(InputError, match="nowhere"):  # whose median the constant is can be told
        evaluate_predictor([tiny_data], options, out=tmp_path, training_data=["nowhere"])
    write_predictor_report(tmp_path / "out", result)
    tree = json.loads((tmp_path / "out" / "predictor.json").read_text())
    assert [r["name"] for r in tree["readings"]] == ["frames in order", "frames shuffled", "a single frame"]
    assert tree["objects"] == 12 and len(next(iter(tree["data"].values()))) == 64
    with Image.open(tmp_path / "out" / "predictor.png") as picture:
        assert picture.width > 1000
    assert "constant" in result.table()


def oracle_of(oracle: Oracle) -> staticmethod:
    return staticmethod(lambda *_, **__: oracle)


def test_skinning_report(tiny_data: Path, tiny_cache: Path, checkpoint: Path, tmp_path: Path) -> None:
    options = EvaluationOptions(checkpoint=str(checkpoint), cache=tiny_cache, limit=5, workers=0)
    result = evaluate_skinning([tiny_data], options, out=tmp_path)
    assert result.of_all.shape == result.beyond_affine.shape == (5, 3)
    assert ((result.beyond_affine >= 0) & (result.beyond_affine <= 1)).all()
    assert (result.of_all >= result.beyond_affine - 1e-9).all()
    assert (result.of_all > 0.9).all()  # falling is affine
    write_skinning_report(tmp_path / "out", result)
    tree = json.loads((tmp_path / "out" / "skinning.json").read_text())
    assert set(tree["captured_share_mean"]) == {"predicted", "eigenmodes", "random"}
    assert (tmp_path / "out" / "skinning.png").stat().st_size > 10_000
    assert "eigenmodes" in result.table()


def test_all_objects_of_a_data_set_can_be_read(tiny_data: Path, tiny_cache: Path, checkpoint: Path) -> None:
    predictor = PhysicsPredictor.from_pretrained(checkpoint)
    sizes = {split: len(held_out([tiny_data], predictor, split=split, cache=tiny_cache)) for split in ("test", "all")}
    assert sizes == {"test": 12, "all": 72}
