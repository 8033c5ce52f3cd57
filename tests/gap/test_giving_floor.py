"""A soft, damped floor is found beside E; a hard one is left alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.gap import (
    DEFAULT_EFFECTS,
    EffectModel,
    GapOptions,
    Situation,
    applicable,
    find_setting,
    numerical_differences,
    rough_baseline,
)
from physconvex.gap.base.baseline import FLOOR_LAW, Baseline
from physconvex.gap.base.observed_points import depth_seen
from physconvex.gap.errors import numerical_differences as differences
from physconvex.io import Capture, Floor, Tracks, save_capture
from physconvex.mesh import TetMesh, box_mesh
from physconvex.reduced import parameter_values

MODULUS, SIGMA, FPS = 4e4, 1e-5, 100.0
OPTIONS = GapOptions(max_nodes=130, weights=4)


def dropped(
    folder: Path, *, frames: int, lowered: float = 0.0, leaning: float = 0.0, friction: float = 0.0, **world: float
) -> Capture:
    """A cube that falls on a floor; the markers' frame may be lowered [m], and gravity lean unsaid [m/s²]."""
    box = box_mesh((0.1, 0.1, 0.1), (2, 2, 2), order=2)
    mesh = TetMesh(box.vertices - box.vertices.min(0) + [0, 0, 0.02], box.tets)
    body = ElasticBody(mesh, youngs_modulus=MODULUS, poisson_ratio=0.35)
    scene = Scene(
        body, obstacles=(Plane(friction=friction),), initial_velocity=(0.0, 0.0, -1.5), gravity=(leaning, 0.0, -9.81),
        **world,
    )  # fmt: skip
    run = simulate(scene, Timing(frames=frames, fps=FPS, steps_per_frame=8))
    shown = np.unique(mesh.boundary_faces)[::2]
    rng = np.random.default_rng(0)
    positions = run.positions[:, shown] - [0, 0, lowered]
    positions = positions + SIGMA * rng.normal(size=positions.shape)
    capture = Capture(
        folder / "capture", FPS, frames, (2 * frames) // 3, gravity=np.array([0, 0, -9.81]), density=1000.0,
        floor=Floor(np.zeros(3), np.array([0.0, 0.0, 1.0])), initial_velocity=np.array([0, 0, -1.5]),
        initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    tracks = Tracks(mesh.vertices[shown], positions, np.full(positions.shape[:2], SIGMA))
    shape = box_mesh((0.1, 0.1, 0.1), (2, 2, 2), order=1)
    tets = TetMesh(shape.vertices - shape.vertices.min(0) + [0, 0, 0.02], shape.tets)
    save_capture(capture, tets=tets, tracks=tracks)
    return capture


def rough(capture: Capture) -> Baseline:
    return rough_baseline(capture, OPTIONS, lambda text: None)


@pytest.mark.slow
def test_a_floor_that_gives_way_is_found_with_the_right_modulus(tmp_path: Path) -> None:
    capture = dropped(tmp_path, frames=18, contact_stiffness=8e5, contact_damping=6e-3)
    hard = rough(capture)
    soft = find_setting(hard, OPTIONS, lambda text: None).base
    assert abs(hard.fit.value("log10_youngs_modulus") - np.log10(MODULUS)) > 0.15  # E stands in for the floor
    assert soft.model.base[-2:] == FLOOR_LAW and soft.situation.giving_floor
    assert soft.fit.value("log10_youngs_modulus") == pytest.approx(np.log10(MODULUS), abs=0.08)
    assert soft.fit.value("log10_contact_stiffness") == pytest.approx(np.log10(8e5), abs=0.2)
    assert soft.fit.value("contact_damping") == pytest.approx(6e-3, rel=0.4)
    left, before = (np.linalg.norm(b.residual(b.positions)) for b in (soft, hard))
    assert left < 0.3 * before


@pytest.mark.slow
def test_a_floor_that_gives_way_is_found_under_a_tilt_that_is_not_known(tmp_path: Path) -> None:
    """The tilt makes most of the squares, which the floor's give alone does not halve."""
    capture = dropped(tmp_path, frames=18, leaning=2.0, contact_stiffness=8e5, contact_damping=6e-3)
    hard = rough(capture)
    soft = find_setting(hard, OPTIONS, lambda text: None).base
    left, before = (np.square(b.residual(b.positions)).sum() for b in (soft, hard))
    assert left > 0.5 * before
    assert soft.situation.giving_floor
    assert soft.fit.value("log10_youngs_modulus") == pytest.approx(np.log10(MODULUS), abs=0.1)


@pytest.mark.slow
def test_a_damped_body_is_found_soft_and_damped_and_not_stiff(tmp_path: Path) -> None:
    hard = rough(dropped(tmp_path, frames=18, damping_time=8e-3))
    found = find_setting(hard, OPTIONS, lambda text: None)
    assert found.damped is not None and [e.name for e in found.damped.model.effects] == ["damping"]
    modulus, _, damping = found.damped.fit.values
    assert modulus == pytest.approx(np.log10(MODULUS), abs=0.1)
    assert damping == pytest.approx(8e-3, rel=0.3)
    assert found.base.fit.value("log10_youngs_modulus") == modulus  # where the base fit begins
    left, before = (np.linalg.norm(b.residual(b.positions)) for b in (found.damped, hard))
    assert left < 0.3 * before


@pytest.mark.slow
def test_a_hard_floor_stays_as_it_is(tmp_path: Path) -> None:
    hard = rough(dropped(tmp_path, frames=18))
    found = find_setting(hard, OPTIONS, lambda text: None)
    assert found.base is hard and found.damped is None and not found.own


def test_a_shifted_frame_of_the_markers_is_no_depth(tmp_path: Path) -> None:
    base = rough(dropped(tmp_path, frames=8, lowered=0.03))
    assert base.situation.depth == depth_seen(base.capture, base.observations, base.split.fitted)
    assert base.situation.depth < 0.01 * base.situation.size


def test_the_fitted_stiffness_of_a_giving_floor_is_no_numerical_error(tmp_path: Path, monkeypatch) -> None:
    """Else the frames after the impact count for nothing, and the first of them decide E alone."""
    base = rough(dropped(tmp_path, frames=8))
    assert base.situation.touches
    monkeypatch.setattr(EffectModel, "motion", lambda self, values: base.motion)
    monkeypatch.setattr(EffectModel, "reduced_motion", lambda self, values: base.motion)
    monkeypatch.setattr(differences, "other_mesh", lambda *arguments: base.model.twin.mesh)
    for giving in (False, True):
        there = replace(base, situation=replace(base.situation, giving_floor=giving))
        found = numerical_differences(there, OPTIONS, lambda text: None)
        assert found.contact.any() == (not giving)


def test_the_dashpot_of_a_giving_floor_is_no_cause_beside() -> None:
    hard = Situation(0.1, 4e4, 1000.0, 60.0, 10, floor=True, touches=True)
    soft = Situation(0.1, 4e4, 1000.0, 60.0, 10, floor=True, touches=True, giving_floor=True)
    names = [{e.name for e in applicable(DEFAULT_EFFECTS, s)} for s in (hard, soft)]
    assert names[0] - names[1] == {"restitution", "contact_stiffness"}


def test_floor_parameters_go_into_a_twin_and_come_out_again(tmp_path: Path) -> None:
    twin = rough(dropped(tmp_path, frames=6)).model.twin
    names = ("log10_youngs_modulus", *FLOOR_LAW)
    values = np.array([4.5, 5.9, 2e-3])
    changed = twin.with_values(names, values)
    np.testing.assert_allclose(parameter_values(changed.scene, names), values)
    assert changed.full_scene().contact_damping == 2e-3
