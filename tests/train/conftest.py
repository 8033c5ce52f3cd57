"""A tiny data set in the documented format: discs that fall, squash by their stiffness, and rise again."""

from pathlib import Path

import numpy as np
import pytest

from data_gen.dataset import RenderedView, finish_dataset, write_simulation
from data_gen.simulate import Samples
from models import BinConfig, EncoderConfig, KinematicsConfig, NetworkConfig
from models.config import SkinningConfig
from physconvex.io import look_at, write_video
from train import TrainConfig

SIZE, FPS, FRAMES, PIXELS = 1.0, 24.0, 16, 48
GRAVITY, DENSITY = 9.81, 1000.0


def disc_path(stiffness: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Height of the centre over rest contact and squash [m]: free fall, half a sine on a spring, free flight.

    The spring has the frequency √(stiffness · g / L), so its half period is what tells stiffness from motion.
    """
    time = np.arange(FRAMES) / FPS
    speed, landing = np.sqrt(2 * GRAVITY * height), np.sqrt(2 * height / GRAVITY)
    frequency = np.sqrt(stiffness * GRAVITY / SIZE)
    since = time - landing
    leaving = since - np.pi / frequency
    pressed = -speed / frequency * np.sin(np.clip(frequency * since, 0, np.pi))
    falling = height - GRAVITY * time**2 / 2
    rising = speed * leaving - GRAVITY * leaving**2 / 2
    path = np.where(since < 0, falling, np.where(leaving < 0, pressed, np.maximum(rising, 0)))
    return path, np.clip(-pressed, 0, 0.6) * ((since >= 0) & (leaving < 0))


def disc_clip(path: np.ndarray, squash: np.ndarray, colour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[0:PIXELS, 0:PIXELS] + 0.5
    radius, floor = PIXELS / 5, PIXELS * 0.95
    frames, masks = [], []
    for height, flat in zip(path, squash, strict=True):
        tall, wide = radius * (1 - flat), radius * (1 + flat / 2)
        centre = floor - tall - max(height, 0) * 2 * radius
        cover = ((columns - PIXELS / 2) / wide) ** 2 + ((rows - centre) / tall) ** 2 < 1
        frames.append(np.where(cover[..., None], colour, np.uint8([200, 200, 200])))
        masks.append(cover)
    return np.stack(frames).astype(np.uint8), np.stack(masks)


def write_disc(root: Path, number: int, split: str, generator: np.random.Generator) -> None:
    stiffness, poisson = 10 ** generator.uniform(0.5, 2.5), generator.uniform(0.2, 0.49)
    path, squash = disc_path(stiffness, generator.uniform(0.2, 0.4))
    frames, masks = disc_clip(path, squash, generator.integers(20, 120, 3))
    camera = look_at((0, -4, 0.5), (0, 0, 0.5), width=PIXELS, height=PIXELS, vertical_field_of_view=0.6)
    points = generator.uniform(-0.5, 0.5, (64, 3)) * SIZE
    samples = Samples(
        points=points,
        volume_weights=np.full(64, 1 / 64),
        displacements=path[:, None, None] * [0, 0, 1] + squash[:, None, None] * points[:, [2, 0, 1]] ** 2,
        modes=np.cos(np.pi * (points / SIZE + 0.5)),
        eigenvalues=np.ones(3),
    )
    metadata = {
        "split": split,
        "object_id": f"disc{number}",
        "attempt": 0,
        "fps": FPS,
        "youngs_modulus": stiffness * DENSITY * GRAVITY * SIZE,
        "poisson_ratio": poisson,
        "density": DENSITY,
        "object_size": SIZE,
    }
    video = root / f"{number}.mp4"
    write_video(video, frames, fps=FPS)
    view = RenderedView(video.read_bytes(), masks, {"camera": camera.to_json()})
    write_simulation(root, number, metadata, samples, [view])
    video.unlink()


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiny_data")
    generator = np.random.default_rng(0)
    splits = ["train"] * 48 + ["validation"] * 12 + ["test"] * 12
    for number, split in enumerate(splits):
        write_disc(folder, number, split, generator)
    finish_dataset(folder, {}, 0, "test")
    return folder


@pytest.fixture(scope="session")
def tiny_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="session")
def tiny_config() -> TrainConfig:
    network = NetworkConfig(
        encoder=EncoderConfig(image_size=32, frames=16, hidden_size=24, layers=1, heads=3, tubelet=4),
        kinematics=KinematicsConfig(
            channels=32, blocks=2, material_blocks=2, frame_widths=(8, 16), dropout=0.0, drop_path=0.0
        ),
        stiffness=BinConfig(low=-0.5, high=3.5, bins=40),
        poisson=BinConfig(low=0.0, high=0.5, bins=10),
        skinning=SkinningConfig(handles=3, hidden_size=16, layers=1),
        latent_size=32,
        dropout=0.0,
    )
    return TrainConfig(
        network=network,
        epochs=4,
        batch_size=8,
        learning_rate=3e-3,
        ema_decay=0.9,
        workers=0,
        loss={"modes": 3},
    )
