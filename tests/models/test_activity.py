import numpy as np

from models import moving_window


def _square(*, noise: float, step: int = 4, count: int = 12) -> np.ndarray:
    """A square of 10 x 10 px that moves to the right from (20, 30), before even grey."""
    generator = np.random.default_rng(0)
    frames = np.full((count, 64, 80, 3), 120.0)
    for k in range(count):
        frames[k, 30:40, 20 + step * k : 30 + step * k] = [200, 60, 60]
    return (frames + noise * generator.standard_normal(frames.shape)).clip(0, 255).astype(np.uint8)


def test_window_holds_all_that_moves() -> None:
    rows, columns = moving_window(_square(noise=2.0), margin=0) or (slice(0), slice(0))
    assert abs(rows.start - 30) <= 1 and abs(rows.stop - 40) <= 1
    assert abs(columns.start - 20) <= 1 and abs(columns.stop - 74) <= 1


def test_window_ends_at_the_border() -> None:
    rows, columns = moving_window(_square(noise=0.0), margin=100) or (slice(0), slice(0))
    assert (rows, columns) == (slice(0, 64), slice(0, 80))


def test_noise_is_no_motion() -> None:
    assert moving_window(_square(noise=4.0, step=0)) is None


def test_flicker_of_everything_is_no_motion() -> None:
    frames = _square(noise=0.0)
    frames[6:] = np.minimum(frames[6:].astype(int) + 40, 255).astype(np.uint8)
    assert moving_window(frames) is None
