"""Skinning weights: losses that see only the span, captured energy, and the stand-alone field."""

from pathlib import Path

import numpy as np
import pytest
import torch

from models import captured_energy, captured_energy_loss, random_basis, span_loss
from models.config import SkinningConfig
from models.skinning import SkinningHead
from physconvex import InputError
from physconvex.reduced import SkinningField


@pytest.fixture
def body() -> tuple[np.ndarray, np.ndarray]:
    """Points of a brick and their volumes, uneven."""
    generator = np.random.default_rng(0)
    return generator.uniform(-0.5, 0.5, (300, 3)) * [1.0, 0.6, 0.4], generator.uniform(0.5, 1.5, 300)


def bending(points: np.ndarray, frames: int = 6) -> np.ndarray:
    """Displacements x-dependent and more than affine: u_z = a_t x², u_x = b_t x z."""
    a, b = np.linspace(0, 0.1, frames)[:, None], np.linspace(0.05, 0, frames)[:, None]
    x, _, z = points.T
    return np.stack([b * x * z, 0 * a * x, a * x**2], axis=-1)


def test_affine_motion_is_captured_without_handles(body: tuple[np.ndarray, np.ndarray]) -> None:
    points, volumes = body
    affine = np.stack([points @ np.diag([0.1, 0, -0.2]) + [0, 0, t] for t in (0.0, 1.0)])
    share = captured_energy(affine, rest=points, volume_weights=volumes, weights=np.zeros((300, 1)))
    assert share == pytest.approx(1.0, abs=1e-12)


def test_the_right_handle_captures_bending_and_a_wrong_one_does_not(body: tuple[np.ndarray, np.ndarray]) -> None:
    """With W = x, W·[X; 1] spans x² and x z exactly."""
    points, volumes = body
    motion = bending(points)

    def share(weights: np.ndarray) -> float:
        return captured_energy(motion, rest=points, volume_weights=volumes, weights=weights, after="affine")

    assert share(points[:, :1]) == pytest.approx(1.0, abs=1e-9)
    assert share(points[:, 1:2]) < 0.5
    noise = np.random.default_rng(1).standard_normal((300, 1))
    assert share(noise) < 0.1


def test_captured_energy_is_weighted_by_volume() -> None:
    """Two points move alone; the handle follows one of them: the share is its volume's."""
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3))
    motion = np.zeros((1, 40, 3))
    motion[0, 0, 0], motion[0, 1, 0] = 1.0, 1.0
    weights, volumes = np.zeros((40, 1)), np.full(40, 1.0)
    weights[0], volumes[0] = 1.0, 1e6
    share = captured_energy(motion, rest=points, volume_weights=volumes, weights=weights)
    assert share == pytest.approx(1.0, abs=1e-5)
    volumes[0], volumes[1] = 1.0, 1e6
    rest_of_it = captured_energy(motion, rest=points, volume_weights=volumes, weights=np.zeros((40, 1)))
    both = captured_energy(motion, rest=points, volume_weights=volumes, weights=weights)
    assert both - rest_of_it < 1e-5


def test_the_loss_is_what_captured_energy_says(body: tuple[np.ndarray, np.ndarray]) -> None:
    points, volumes = body
    weights = random_basis(4, generator=np.random.default_rng(3))(points)
    motion = bending(points) + 0.01 * np.random.default_rng(4).standard_normal((6, 300, 3))
    expected = captured_energy(motion, rest=points, volume_weights=volumes, weights=weights, after="affine")
    loss = captured_energy_loss(
        torch.from_numpy(weights)[None],
        torch.from_numpy(np.moveaxis(motion, 0, 1).reshape(1, 300, -1)),
        torch.from_numpy(points)[None],
        torch.from_numpy(volumes)[None],
    )
    assert float(loss) == pytest.approx(1 - expected, abs=1e-4)


def test_span_loss_sees_the_span_only(body: tuple[np.ndarray, np.ndarray]) -> None:
    points, volumes = (torch.from_numpy(array)[None] for array in body)
    modes = torch.cos(torch.pi * (points + 0.5))
    importance = torch.ones(1, 3)
    mixing = torch.tensor([[1.0, 2.0, 0.0], [0.0, 1.0, -3.0], [0.5, 0.0, 1.0]], dtype=torch.float64)
    same = span_loss(modes @ mixing + 7.0, modes, volumes, importance)
    assert float(same) < 1e-4
    two = span_loss(modes[..., :2], modes, volumes, importance)
    assert 0.25 < float(two) < 0.34  # the third is missed but for chance correlation
    low_first = span_loss(modes[..., :2], modes, volumes, torch.tensor([[1.0, 1.0, 0.0]]))
    assert float(low_first) < 1e-4


def test_span_loss_can_be_learnt(body: tuple[np.ndarray, np.ndarray]) -> None:
    """The head finds the modes of a brick from scratch."""
    points, volumes = (torch.from_numpy(array).float()[None] for array in body)
    modes = torch.cos(torch.pi * points * torch.tensor([1.0, 1 / 0.6, 1 / 0.4]) + torch.pi / 2)
    head, latent = SkinningHead(4, SkinningConfig(handles=3, hidden_size=32, layers=2)), torch.ones(1, 4)
    optimizer = torch.optim.Adam(head.parameters(), lr=1e-2)
    history = []
    for _ in range(60):
        loss = span_loss(head(latent, points), modes, volumes, torch.ones(1, 3)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        history.append(loss.item())
    assert history[-1] < 0.1 < history[0]


@pytest.fixture
def field() -> tuple[SkinningHead, torch.Tensor, SkinningField]:
    head, latent = SkinningHead(8, SkinningConfig()), torch.randn(2, 8)
    with torch.no_grad():
        return head, latent, head.fields(latent, [0.4, 1.7])[1]


def test_frozen_field_is_the_head(field: tuple[SkinningHead, torch.Tensor, SkinningField]) -> None:
    head, latent, frozen = field
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 3))
    with torch.no_grad():
        expected = head(latent, torch.from_numpy(points / 1.7).float().expand(2, -1, -1))[1]
    np.testing.assert_allclose(frozen(points), expected, atol=1e-5)
    assert frozen.handles == 10 and frozen(points).dtype == np.float32


def test_gradient_is_that_of_finite_differences(field: tuple[SkinningHead, torch.Tensor, SkinningField]) -> None:
    frozen = field[2]
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (20, 3))
    step = 1e-2
    differences = [(frozen(points + step * axis) - frozen(points - step * axis)) / (2 * step) for axis in np.eye(3)]
    np.testing.assert_allclose(frozen.gradient(points), np.stack(differences, axis=-1), atol=2e-3)


def test_field_survives_a_file(field: tuple[SkinningHead, torch.Tensor, SkinningField], tmp_path: Path) -> None:
    frozen = field[2]
    frozen.save(tmp_path / "field.safetensors")
    loaded = SkinningField.load(tmp_path / "field.safetensors")
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (9, 3))
    np.testing.assert_array_equal(loaded(points), frozen(points))
    assert loaded.object_size == 1.7


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no skinning field"):
        SkinningField.load(tmp_path / "nothing")


@pytest.mark.wrong_types
def test_points_of_another_shape_are_refused(field: tuple[SkinningHead, torch.Tensor, SkinningField]) -> None:
    with pytest.raises(InputError, match=r"expected \[Q, 3\]"):
        field[2](np.zeros((4, 2)))
