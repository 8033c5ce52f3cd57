"""Encoder, position tables, pretrained weights, kinematics, and the whole network."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from transformers import VideoMAEConfig, VideoMAEModel

from models import (
    MOMENT_NAMES,
    STATE_NAMES,
    ClipBatch,
    EncoderConfig,
    KinematicsConfig,
    NetworkConfig,
    PhysicsNetwork,
    load_pretrained_encoder,
    silhouette_moments,
)
from models.encoder import VideoEncoder, normalised, position_table, token_coverage
from models.kinematics import kinematic_features
from physconvex import InputError

SMALL = EncoderConfig(image_size=32, frames=8, hidden_size=48, layers=2, heads=4)
NETWORK = NetworkConfig(
    encoder=SMALL,
    kinematics=KinematicsConfig(channels=16, blocks=2, material_blocks=2, frame_widths=(8, 16)),
    latent_size=16,
)


def random_batch(count: int = 3, seed: int = 0, frames: int = 8, size: int = 32) -> ClipBatch:
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randint(0, 256, shape, generator=generator, dtype=torch.uint8)

    return ClipBatch(
        windows=draw(count, frames, size, size, 4),
        moments=torch.rand(count, frames, len(MOMENT_NAMES), generator=generator),
        valid=torch.ones(count, frames, dtype=torch.bool),
        interval=torch.full((count,), 0.13),
        confidence=torch.ones(count),
    )


def saved_videomae(folder: Path, **options: int) -> VideoMAEModel:
    sizes = {"hidden_size": 48, "num_hidden_layers": 2, "num_attention_heads": 4, "intermediate_size": 192}
    model = VideoMAEModel(VideoMAEConfig(**{**sizes, **options})).eval()
    model.save_pretrained(folder)
    return model


def test_position_table_is_videomae_s_own_at_its_size() -> None:
    config = SMALL.model_copy(update={"position_grid": SMALL.grid})
    ours = VideoEncoder(config).model.embeddings.position_embeddings
    theirs = VideoMAEModel(VideoEncoder(config).model.config).embeddings.position_embeddings
    assert torch.equal(ours, theirs)


def test_position_table_of_another_size_is_between_the_known_places() -> None:
    """Twice the frames: each new place in time is a quarter beside an old one; rows and columns stay."""
    grid = (4, 2, 2)
    known = position_table(SMALL.model_copy(update={"position_grid": grid})).view(4, 2, 2, -1)
    longer = SMALL.model_copy(update={"frames": 16, "position_grid": grid})
    table = position_table(longer).view(8, 2, 2, -1)
    torch.testing.assert_close(table[1], 0.75 * known[0] + 0.25 * known[1])
    torch.testing.assert_close(table[4], 0.25 * known[1] + 0.75 * known[2])


def test_own_position_table_tells_every_place_apart() -> None:
    table = position_table(EncoderConfig())[0]
    distance = torch.cdist(table, table) + 10 * torch.eye(len(table))
    assert float(distance.min()) > 0.1


def test_pretrained_weights_give_their_own_model_at_their_size(tmp_path: Path) -> None:
    theirs = saved_videomae(tmp_path, image_size=32, num_frames=8)
    config = EncoderConfig(image_size=32, frames=8, mask_channel=False, eval_keep=1.0, hidden_size=96, heads=3)
    encoder = load_pretrained_encoder(tmp_path, config).eval()
    batch = random_batch()
    tokens, _, _ = encoder(normalised(batch.windows))
    mean, std = torch.tensor([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])[..., None, None]
    pixels = (batch.windows[..., :3].movedim(-1, 2).float() / 255 - mean) / std
    torch.testing.assert_close(tokens, theirs(pixels).last_hidden_state, atol=1e-4, rtol=1e-4)


def test_pretrained_weights_at_another_size_and_with_a_mask(tmp_path: Path) -> None:
    """16 × 224² weights read 24 × 112² clips; the mask changes nothing before training."""
    saved_videomae(tmp_path, image_size=224, num_frames=16)
    encoder = load_pretrained_encoder(tmp_path, EncoderConfig(image_size=112, frames=24, eval_keep=1.0)).eval()
    assert encoder.config.position_grid == (8, 14, 14) and encoder.config.grid == (12, 7, 7)
    batch = random_batch(1, frames=24, size=112)
    pictures = normalised(batch.windows)
    tokens, _, _ = encoder(pictures)
    without, _, _ = encoder(torch.cat([pictures[:, :, :3], torch.ones_like(pictures[:, :, 3:])], dim=2))
    assert tokens.shape == (1, 588, 48)
    torch.testing.assert_close(tokens.sort(dim=1).values, without.sort(dim=1).values)


@pytest.mark.parametrize("tubelet", [1, 4])
def test_another_tubelet_embeds_a_still_clip_alike(tmp_path: Path, tubelet: int) -> None:
    saved_videomae(tmp_path, image_size=32, num_frames=8)
    config = EncoderConfig(image_size=32, frames=8, mask_channel=False)
    pixels = torch.rand(1, 1, 3, 32, 32).expand(-1, 8, -1, -1, -1)
    usual = load_pretrained_encoder(tmp_path, config).model.embeddings.patch_embeddings(pixels)
    other = load_pretrained_encoder(tmp_path, config.model_copy(update={"tubelet": tubelet}))
    torch.testing.assert_close(other.model.embeddings.patch_embeddings(pixels)[:, :4], usual[:, :4])


def test_missing_weights_are_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="pretrained: no VideoMAE weights"):
        load_pretrained_encoder(tmp_path / "nothing", SMALL)


def test_tokens_that_show_the_object_are_kept() -> None:
    config = SMALL.model_copy(update={"train_keep": 0.35, "eval_keep": 0.5})
    encoder = VideoEncoder(config)
    windows = random_batch(2).windows
    windows[..., 3] = 0
    windows[:, :, :16, 16:, 3] = 255  # one of four patches in each of four tubelets
    pictures = normalised(windows)
    assert token_coverage(pictures[:, :, 3], config).view(2, 4, 2, 2)[0, :, 0, 1].eq(1).all()
    for training, kept in ((True, round(0.35 * 16)), (False, 8)):
        generator = torch.Generator().manual_seed(0)
        tokens, coverage, place = encoder.train(training)(pictures, generator=generator)
        assert place.diff(dim=1).gt(0).all() and tokens.shape[:2] == place.shape
        assert coverage.shape == (2, kept)
        assert coverage.sum(dim=1).eq(4).all()


def test_kinematic_features_of_free_fall_are_gravity() -> None:
    """y = −½ t² in units of L and √(L/g): second differences are −1 in every frame that has neighbours."""
    interval = 0.13
    time = torch.arange(8) * interval
    moments = torch.zeros(1, 8, len(MOMENT_NAMES))
    moments[0, :, MOMENT_NAMES.index("centroid_y")] = -0.5 * time**2
    valid = torch.arange(8)[None] < 7
    features = kinematic_features(moments, torch.tensor([interval]), valid)
    second = features[0, :, 20 + MOMENT_NAMES.index("centroid_y")]
    torch.testing.assert_close(second[1:6], torch.full((5,), -1.0), atol=1e-4, rtol=0)
    assert second[0] == second[6] == second[7] == 0


def test_one_clip_s_answer_does_not_depend_on_its_batch() -> None:
    network = PhysicsNetwork(NETWORK).eval()
    batch = random_batch(3)
    alone = ClipBatch(**{name: value[1:2] for name, value in vars(batch).items()})
    torch.testing.assert_close(network(batch).latent[1:2], network(alone).latent, atol=1e-5, rtol=1e-4)


def test_padded_frames_of_the_kinematics_are_not_read() -> None:
    network = PhysicsNetwork(NETWORK).eval()
    batch = random_batch(1)
    valid = torch.arange(8)[None] < 5
    other = batch.moments.clone()
    other[:, 5:] += 1
    pairs = [dataclasses.replace(batch, valid=valid, moments=moments) for moments in (batch.moments, other)]
    latents = [network(pair).latent for pair in pairs]
    assert not torch.equal(latents[0], network(batch).latent)
    torch.testing.assert_close(*latents)


def test_every_parameter_learns() -> None:
    shown = {"video_dropout": 0.0, "feature_dropout": 0.0, "given_states": 0.0}
    network = PhysicsNetwork(NETWORK.model_copy(update=shown))
    for parameter in network.parameters():  # leave the zeros some layers start from
        torch.nn.init.normal_(parameter, std=0.1)
    output = network(random_batch(4), torch.rand(4, 20, 3) - 0.5, generator=torch.Generator().manual_seed(0))
    assert output.weights is not None
    total = output.stiffness_logits.square().sum() + output.poisson_logits.square().sum()
    (total + output.weights.square().sum() + output.states.square().sum()).backward()
    dead = [name for name, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert dead == []


def test_answers_follow_from_the_states_given() -> None:
    """With the features hidden and true states given, what is seen no longer matters; the states do."""
    told = NETWORK.model_copy(update={"given_states": 0.999, "feature_dropout": 0.999, "video_dropout": 0.999})
    network = PhysicsNetwork(told).train()
    for module in network.modules():
        if hasattr(module, "drop_prob") or isinstance(module, torch.nn.Dropout):
            module.eval()
    states = torch.randn(2, 8, len(STATE_NAMES), generator=torch.Generator().manual_seed(3))

    def answer(seed: int, states: torch.Tensor) -> torch.Tensor:
        draws = torch.Generator().manual_seed(0)
        return network(random_batch(2, seed), states=states, generator=draws).stiffness_logits

    assert torch.equal(answer(1, states), answer(2, states))
    assert not torch.equal(answer(1, states), answer(1, states + 0.1))
    network.eval()  # at inference nothing is given
    assert torch.equal(answer(1, states), answer(1, states + 0.1))
    assert not torch.equal(answer(1, states), answer(2, states))


def test_training_draws_come_from_the_generator() -> None:
    network = PhysicsNetwork(NETWORK.model_copy(update={"dropout": 0.0})).train()
    for module in network.modules():
        if hasattr(module, "drop_prob") or isinstance(module, torch.nn.Dropout):
            module.eval()
    batch = random_batch(3)
    latents = [network(batch, generator=torch.Generator().manual_seed(seed)).latent for seed in (0, 0, 1)]
    assert torch.equal(latents[0], latents[1]) and not torch.equal(latents[0], latents[2])


def test_moment_names_match_the_feature_scale() -> None:
    """The branch reads all but the last moment as lengths; the last is the flag."""
    mask = np.zeros((4, 32, 32), np.uint8)
    mask[:, 10:20, 8:24] = 255
    assert MOMENT_NAMES[-1] == "touches_border"
    features = kinematic_features(
        torch.from_numpy(silhouette_moments(mask).moments)[None], torch.tensor([0.1]), torch.ones(1, 4, dtype=bool)
    )
    assert features.shape[-1] == len(PhysicsNetwork(NETWORK).silhouettes.feature_scale)


def test_impossible_configurations_are_refused() -> None:
    with pytest.raises(ValueError, match="multiples"):
        EncoderConfig(image_size=100)
    with pytest.raises(ValueError, match=r"within \(0, 0.5\)"):
        NetworkConfig(poisson={"low": 0.0, "high": 0.6, "bins": 10})
    assert EncoderConfig.of_size("base", image_size=224).hidden_size == 768
