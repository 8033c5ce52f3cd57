"""Checkpoint folders: what goes in comes out, and bad folders are named."""

import json
from pathlib import Path

import pytest
import torch

from models import (
    Calibration,
    DensityCalibration,
    EncoderConfig,
    NetworkConfig,
    PhysicsNetwork,
    PredictorConfig,
    load_checkpoint,
    save_network,
)
from physconvex import InputError

NETWORK = NetworkConfig(encoder=EncoderConfig(image_size=32, frames=8, hidden_size=24, layers=1), latent_size=16)


@pytest.fixture
def saved(tmp_path: Path) -> tuple[Path, PhysicsNetwork, PredictorConfig]:
    network = PhysicsNetwork(NETWORK).eval()
    calibration = Calibration(poisson=DensityCalibration(temperature=2.0, central_level=0.95), clips=33)
    config = PredictorConfig.for_network(NETWORK, calibration=calibration, metrics={"mae": 0.25})
    save_network(tmp_path, network, config, model_card="# A card\n")
    return tmp_path, network, config


def test_round_trip(saved: tuple[Path, PhysicsNetwork, PredictorConfig]) -> None:
    folder, network, config = saved
    loaded, found = load_checkpoint(folder)
    assert found == config and found.clip.window == 32 and found.clip.frames == 8
    assert not loaded.training
    for (name, before), after in zip(network.state_dict().items(), loaded.state_dict().values(), strict=True):
        assert after.dtype == before.dtype, name
        torch.testing.assert_close(after, before, atol=1e-3, rtol=1e-3, msg=name)  # stored in half precision
    assert sorted(path.name for path in folder.iterdir()) == ["config.json", "model.safetensors", "model_card.md"]


def test_full_precision_is_exact(tmp_path: Path) -> None:
    network = PhysicsNetwork(NETWORK)
    config = PredictorConfig.for_network(NETWORK)
    save_network(tmp_path, network, config, model_card="", half=False)
    loaded, _ = load_checkpoint(tmp_path)
    for before, after in zip(network.state_dict().values(), loaded.state_dict().values(), strict=True):
        assert torch.equal(before, after)


def test_missing_and_foreign_checkpoints(saved: tuple[Path, PhysicsNetwork, PredictorConfig], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="name of a bundled one"):
        load_checkpoint("no_such_checkpoint")
    folder = saved[0]
    with pytest.raises(InputError, match="device: 'abacus'"):
        load_checkpoint(folder, device="abacus")
    tree = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(tree | {"format": "physconvex/predictor/99"}))
    with pytest.raises(InputError, match="predictor/99"):
        load_checkpoint(folder)
    tree["network"]["latent_size"] = 17
    (folder / "config.json").write_text(json.dumps(tree))
    with pytest.raises(InputError, match="do not fit"):
        load_checkpoint(folder)
    (folder / "config.json").write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        load_checkpoint(folder)
