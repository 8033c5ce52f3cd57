"""A recording made with linear elements that lock is modelled with those elements; one made with better ones is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physconvex.dynamics import Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene
from physconvex.gap import GapOptions, MotionCorrection, error_model, fit_baseline, rough_baseline
from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.model import reduced_like
from physconvex.gap.conditions.capture_elements import mesh_of_capture_elements, with_own_elements
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.judgement.caveats import _elements
from physconvex.gap.search.hypothesis import base_hypothesis
from physconvex.gap.thresholds import BASE_FIT
from physconvex.io import Boundary, Capture, Tracks, save_capture
from physconvex.mesh import TetMesh, box_mesh

MODULUS, SIGMA, FPS, FRAMES = 2e5, 2e-5, 60.0, 18
OPTIONS = GapOptions(max_nodes=100, weights=4, iterations=6)


def released(folder: Path, order: int, *, particles: bool = False, tilt: float = 0.0) -> Capture:
    """A beam that is held at one end and let go, simulated with elements of some order on the capture's mesh."""
    size, cells = (0.12, 0.03, 0.03), (6, 1, 1)
    mesh, corners = box_mesh(size, cells, order=order), box_mesh(size, cells, order=1)
    mesh = mesh.with_equal_masses() if particles else mesh
    body = ElasticBody(mesh, youngs_modulus=MODULUS, poisson_ratio=0.4, density=1000.0)
    held = np.flatnonzero(mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 1e-9)
    gravity = 9.81 * np.array([0.0, np.sin(tilt), -np.cos(tilt)])
    run = simulate(
        Scene(body, node_pins=NodePins(held), gravity=gravity), Timing(frames=FRAMES, fps=FPS, steps_per_frame=16)
    )
    shown = np.flatnonzero(mesh.vertices[:, 0] > mesh.vertices[:, 0].max() - 0.03)
    rng = np.random.default_rng(1)
    positions = run.positions[:, shown] + SIGMA * rng.normal(size=(FRAMES, len(shown), 3))
    capture = Capture(
        folder / "capture", FPS, FRAMES, 12, gravity=np.array([0.0, 0.0, -9.81]), density=1000.0,
    )  # fmt: skip
    x = float(mesh.vertices[:, 0].min())
    boundary = Boundary(clamped_box=np.array([[x - 1e-4, -1.0, -1.0], [x + 1e-4, 1.0, 1.0]]))
    tracks = Tracks(mesh.vertices[shown], positions, np.full(positions.shape[:2], SIGMA))
    save_capture(capture, tets=TetMesh(corners.vertices, corners.tets), tracks=tracks, boundary=boundary)
    return capture


def fitted(capture: Capture) -> tuple[Baseline, Baseline, Numerics, np.ndarray]:
    """The base fit and what it came from, without numerical errors."""
    rough = rough_baseline(capture, OPTIONS, lambda text: None)
    still = np.zeros_like(rough.motion.positions)
    numerics = Numerics(still, still, still, still, still)
    variance = np.ones(len(rough.residual(rough.positions)))
    base = fit_baseline(rough, MotionCorrection(still), None, variance, options=OPTIONS, report=lambda text: None)
    return rough, base, numerics, variance


@pytest.mark.slow
def test_elements_that_lock_become_the_model(tmp_path: Path) -> None:
    rough, base, numerics, variance = fitted(released(tmp_path, 1))
    numerics = replace(numerics, exact=(base.model.twin.mesh, numerics.mesh))
    own, left_over = with_own_elements(base, rough, numerics, variance, options=OPTIONS, report=lambda text: None)
    assert own.model.mesh is not None and own.model.mesh.order == 1 and own.model.mesh.mass_shares is None
    assert left_over.exact is None  # which would undo what the elements do
    assert own.fit.value("log10_youngs_modulus") == pytest.approx(np.log10(MODULUS), abs=0.01)
    # E of other elements had to stand in for the locking
    assert abs(base.fit.value("log10_youngs_modulus") - np.log10(MODULUS)) > 0.1
    left, before = (np.linalg.norm(b.residual(b.positions)) for b in (own, base))
    assert left < 0.5 * before
    cheap, _ = reduced_like(own.model, own.motion, own.fit.values)
    assert cheap.mesh is own.model.mesh and own.model.surrogate_stiffer == 0.0  # so few nodes search themselves


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 0.5])  # beside a tilt of gravity, the masses are a small share of the squares
def test_a_recording_of_particles_of_equal_mass_is_modelled_so(tmp_path: Path, tilt: float) -> None:
    rough, base, numerics, variance = fitted(released(tmp_path, 1, particles=True, tilt=tilt))
    own, _ = with_own_elements(base, rough, numerics, variance, options=OPTIONS, report=lambda text: None)
    assert own.model.mesh is not None and own.model.mesh.mass_shares is not None
    assert own.fit.value("log10_youngs_modulus") == pytest.approx(np.log10(MODULUS), abs=0.01)
    told = _elements(base_hypothesis(own, error_model(own, numerics, OPTIONS)))
    assert len(told) == 2 and "same mass" in told[1]


@pytest.mark.slow
def test_a_coarser_mesh_that_searches_is_made_as_stiff(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("physconvex.gap.base.model.BASE_FIT", replace(BASE_FIT, searches_itself=0.0))
    rough, base, numerics, variance = fitted(released(tmp_path, 1))
    own, _ = with_own_elements(base, rough, numerics, variance, options=OPTIONS, report=lambda text: None)
    assert own.model.surrogate_stiffer > 0.05
    assert reduced_like(own.model, own.motion, own.fit.values)[0].mesh is None


@pytest.mark.slow
def test_other_elements_stay_where_they_fit_better(tmp_path: Path) -> None:
    rough, base, numerics, variance = fitted(released(tmp_path, 2))
    own, _ = with_own_elements(base, rough, numerics, variance, options=OPTIONS, report=lambda text: None)
    assert own is base


def test_only_linear_tetrahedra_are_own_elements(tmp_path: Path) -> None:
    rough = rough_baseline(released(tmp_path, 1), OPTIONS, lambda text: None)
    found = mesh_of_capture_elements(rough)
    assert found is not None and found.order == 1 and len(found.vertices) == 28
