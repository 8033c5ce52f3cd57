"""What the error of a reconstructed body does to the estimates: against the theory of a bending bar."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from inference import FittedParameter, RefinementRun, RefineOptions
from inference.refinement.command import _print
from inference.refinement.estimates import fitted_parameters
from inference.refinement.geometry_error import geometry_error, parameter_errors
from inference.refinement.result import ReconstructionRow
from physconvex import ConvergenceError
from physconvex.identify import (
    FitOptions,
    FullModel,
    LinearModel,
    MarkerObservations,
    TwinOptions,
    base_twin,
    default_parameter,
    fit,
    identifiability,
)
from physconvex.io import Capture
from physconvex.mesh import box_mesh
from physconvex.reconstruction import SurfaceError

LENGTH, WIDTH, THICKNESS, OFFSET = 0.3, 0.05, 0.03, 1.5e-4  # [m]


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """A clamped bar that its weight bends, its fit by markers, and its surface."""
    folder = tmp_path_factory.mktemp("bar")
    np.savez(folder / "boundary.npz", clamped_box=np.array([[-1e-6, -1, -1], [1e-6, 1, 1]]))
    body = trimesh.creation.box((LENGTH, WIDTH, THICKNESS)).subdivide_to_size(0.008)
    body.apply_translation([LENGTH / 2, 0, 0])
    mesh = box_mesh((LENGTH, WIDTH, THICKNESS), (8, 1, 1))
    mesh = type(mesh)(mesh.vertices - [0, WIDTH / 2, THICKNESS / 2], mesh.tets)
    capture = Capture(folder, 48.0, 8, 8, body=body)
    twin = base_twin(capture, TwinOptions(weights=4, steps_per_frame=8), mesh=mesh)
    names, values = ("log10_youngs_modulus",), np.array([5.5])
    points = mesh.vertices[mesh.vertices[:, 0] > 0.1]
    model = FullModel(twin, names, points, 8)
    here, tangents = model.linearise(values)
    seen = MarkerObservations(points, here, np.full(here.shape[:2], 1e-3))
    linear = LinearModel(names, values, here, tangents)
    found = fit(linear, seen, [default_parameter(names[0]).at(5.5)], options=FitOptions(max_iterations=1))
    return model, found, seen, body


def error_of(body: trimesh.Trimesh, **stated) -> SurfaceError:
    count = len(body.vertices)
    zero = {"common": 0.0, "local": 0.0, "unseen": np.zeros(count), "length": 0.01}
    return SurfaceError(views=np.full(count, 9), areas=np.ones(count), **zero | stated)


def test_an_offset_moves_the_modulus_as_the_theory_of_beams_says(bar):
    """A bar that is thicker by 2δ and longer by δ swings alike if E is smaller by (1 + 2δ/t)² / (1 + δ/L)⁴."""
    model, found, seen, body = bar
    parts = parameter_errors(model, found, seen, body, error_of(body, common=OFFSET))
    expected = 2 * np.log10(1 + 2 * OFFSET / THICKNESS) - 4 * np.log10(1 + OFFSET / LENGTH)
    assert parts[0, 0] == pytest.approx(expected, rel=0.15)  # shear, mass beyond the end, 160 elements
    assert len(parts) == 3 and parts[1:] == pytest.approx(0, abs=1e-12)


def test_large_displacements_are_taken_as_first_order(bar):
    model, found, seen, body = bar
    once, more = (parameter_errors(model, found, seen, body, error_of(body, common=k * 0.006)) for k in (1.0, 10.0))
    assert more[0] == pytest.approx(10 * once[0], rel=1e-6)  # two hundredths of the size is the most that is tried


def test_an_unseen_half_counts_less_than_the_whole(bar):
    model, found, seen, body = bar
    half = np.where(body.vertices[:, 2] < 0, OFFSET, 0.0)
    parts = parameter_errors(model, found, seen, body, error_of(body, common=OFFSET, unseen=half))
    assert len(parts) == 4 and 0.35 < parts[1, 0] / parts[0, 0] < 0.65  # thicker on one side


def run_with(body: trimesh.Trimesh, error: SurfaceError) -> RefinementRun:
    return RefinementRun(None, reconstruction=SimpleNamespace(body=body, error=error))


@pytest.mark.wrong_types
def test_it_widens_the_interval_and_is_stated_apart(bar):
    model, found, seen, body = bar
    assert geometry_error(RefinementRun(None), model, found, seen) is None
    run = run_with(body, error_of(body, common=OFFSET))
    sigma = geometry_error(run, model, found, seen)
    (alone,), (both,) = (
        fitted_parameters(
            found, np.array([0.003]), identifiability(found), seen.frames, [slice(None)], stated=[True], by_geometry=by
        )
        for by in (None, sigma)
    )
    assert isinstance(both, FittedParameter) and (alone.geometry_error, both.geometry_error) == (0.0, sigma[0])
    assert both.sigma == pytest.approx(np.hypot(alone.sigma, sigma[0])) and both.sigma > 1.5 * alone.sigma
    assert np.ptp(both.interval) == pytest.approx(np.ptp(alone.interval) * both.sigma / alone.sigma)
    assert both.to_json()["geometry_error"] == sigma[0]


@pytest.mark.wrong_types
def test_a_failure_leaves_it_unknown_and_is_told(bar, monkeypatch):
    model, found, seen, body = bar

    def fail(*_):
        raise ConvergenceError("an element turned over")

    monkeypatch.setattr("inference.refinement.geometry_error.parameter_errors", fail)
    run = run_with(body, error_of(body))
    assert np.isnan(geometry_error(run, model, found, seen)).all()
    assert "turned over" in run.warnings[0]
    run.options = RefineOptions(stop_after="convex")  # the quick answer does not wait for it
    assert np.isnan(geometry_error(run, model, found, seen)).all() and len(run.warnings) == 1


@pytest.mark.wrong_types
def test_the_console_shows_it_and_the_reconstruction(tmp_path, capsys):
    estimate = FittedParameter("poisson_ratio", 0.3, 0.01, 0.02, (0.2, 0.4), 0.0, 0.495, None, 0.0347)
    row = ReconstructionRow(volume=1.25e-4, size=0.21, views=12, unseen=0.08, psnr=34.25, seconds=190.0)
    shown = {}
    for made in (None, row):
        _print(SimpleNamespace(
            estimates=[estimate], youngs_modulus=1e5, poisson_ratio=0.3, warnings=[], reconstruction=made,
            identifiability=SimpleNamespace(sentences=[]),
        ), tmp_path)  # fmt: skip
        shown[made] = capsys.readouterr().out
    assert "geometry" not in shown[None] and "0.035" not in shown[None]
    assert "geometry" in shown[row] and "0.035" in shown[row]
    assert "body from 12 pictures: 125 cm³, 210 mm long, 8 % of the surface unseen, PSNR 34.2 dB" in shown[row]
