"""The predictor: similarity, bounds, batches, warnings."""

import numpy as np
import pytest

from models import EncoderConfig, KinematicsConfig, NetworkConfig, PhysicsPredictor, PreparedClip, TrainingRange
from physconvex import InputError

CONFIG = NetworkConfig(
    encoder=EncoderConfig(image_size=32, frames=12, hidden_size=24, layers=1),
    kinematics=KinematicsConfig(channels=16, blocks=1, material_blocks=1, frame_widths=(8, 16)),
    latent_size=16,
)


@pytest.fixture(scope="module")
def predictor() -> PhysicsPredictor:
    return PhysicsPredictor.from_config(CONFIG)


def falling_square(frames: int = 12, step: int = 3) -> np.ndarray:
    video = np.full((frames, 64, 64, 3), 200, np.uint8)
    for t in range(frames):
        video[t, 4 + step * t : 20 + step * t, 24:40] = (40, 60, 90)
    return video


@pytest.fixture(scope="module")
def clip(predictor: PhysicsPredictor) -> PreparedClip:
    return predictor.prepare(falling_square(), fps=24.0)


def test_same_frames_at_twice_the_size_and_fps_over_root_two_are_twice_as_stiff(
    predictor: PhysicsPredictor,
) -> None:
    """The similarity law, through preparation and network."""
    estimates = []
    for size, fps in ((0.5, 24.0), (1.0, 24.0 / np.sqrt(2))):
        clip = predictor.prepare(falling_square(), fps=fps)
        estimates += predictor.estimate([clip], density=[1000.0], object_size=[size])
    assert estimates[1].youngs_modulus / estimates[0].youngs_modulus == pytest.approx(2.0, rel=1e-5)
    assert estimates[1].poisson_ratio == pytest.approx(estimates[0].poisson_ratio, rel=1e-5)


def test_density_scales_the_modulus(predictor: PhysicsPredictor, clip: PreparedClip) -> None:
    light, heavy = predictor.estimate([clip, clip], density=[100.0, 1000.0], object_size=[1.0, 1.0])
    ratio = np.array(heavy.youngs_modulus_interval) / np.array(light.youngs_modulus_interval)
    np.testing.assert_allclose([heavy.youngs_modulus / light.youngs_modulus, *ratio], 10.0, rtol=1e-4)


def test_estimates_are_possible_and_ordered(predictor: PhysicsPredictor, clip: PreparedClip) -> None:
    (estimate,) = predictor.estimate([clip], density=[1000.0], object_size=[1.0])
    low, high = estimate.youngs_modulus_interval
    assert 0 < low < estimate.youngs_modulus < high
    low, high = estimate.poisson_ratio_interval
    assert 0 < low < estimate.poisson_ratio < high < 0.5
    assert estimate.log10_youngs_modulus_std > 0 and estimate.poisson_ratio_std > 0
    weights = estimate.skinning_field(np.zeros((2, 3)))
    assert weights.shape == (2, 10)


def test_batches_are_single_clips(predictor: PhysicsPredictor, clip: PreparedClip) -> None:
    other = predictor.prepare(falling_square(9, 4), fps=30.0)
    both = predictor.estimate([clip, other], density=[1000.0, 500.0], object_size=[1.0, 0.2])
    alone = predictor.estimate([other], density=[500.0], object_size=[0.2])
    assert both[1].youngs_modulus == pytest.approx(alone[0].youngs_modulus, rel=1e-4)
    assert predictor.estimate([], density=[], object_size=[]) == []


def test_clips_beyond_the_training_data_carry_a_warning(predictor: PhysicsPredictor, clip: PreparedClip) -> None:
    known = predictor.config.model_copy(update={"training_range": TrainingRange(log10_stiffness=(-2, 6))})
    careful = PhysicsPredictor(predictor.network, known)
    usual, small = careful.estimate([clip, clip], density=[1000.0] * 2, object_size=[1.0, 0.01])
    assert not usual.out_of_range and usual.warnings == ()
    assert small.out_of_range and "frame interval" in small.warnings[0]
    low = predictor.config.model_copy(update={"training_range": TrainingRange(log10_stiffness=(-3, -2))})
    (stiff,) = PhysicsPredictor(predictor.network, low).estimate([clip], density=[1000.0], object_size=[1.0])
    assert "stiffer than the training data" in stiff.warnings[0]


def test_bad_arguments_are_named(predictor: PhysicsPredictor, clip: PreparedClip) -> None:
    with pytest.raises(InputError, match="one number per clip"):
        predictor.estimate([clip], density=[1.0, 2.0], object_size=[1.0])
    with pytest.raises(InputError, match="density"):
        predictor.estimate([clip], density=[-1.0], object_size=[1.0])
    foreign = PhysicsPredictor.from_config(CONFIG.model_copy(update={"encoder": EncoderConfig()})).prepare(
        falling_square(), fps=24.0
    )
    with pytest.raises(InputError, match=r"clips\[0\]"):
        predictor.estimate([foreign], density=[1.0], object_size=[1.0])


def test_untrained_predictors_of_one_seed_are_one(clip: PreparedClip, predictor: PhysicsPredictor) -> None:
    again = PhysicsPredictor.from_config(CONFIG).estimate([clip], density=[1000.0], object_size=[1.0])
    first = predictor.estimate([clip], density=[1000.0], object_size=[1.0])
    assert again[0].youngs_modulus == first[0].youngs_modulus
