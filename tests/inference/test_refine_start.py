"""Where the scan looks: around the prediction, or everywhere with a note; a prediction given outright."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from inference import RefineOptions
from inference.refinement import coarse_start, reduced_search
from inference.refinement.command import refine_command
from inference.refinement.problem import Problem, moved_inside
from inference.refinement.reduced_search import predicted, scan_range, with_free_height, with_predicted_ratio
from inference.refinement.stages import RefinementRun, Stages, arrays_of_scan
from physconvex import InputError
from physconvex.identify import Candidate, Fit, MarkerObservations, default_parameter
from physconvex.io import Capture, Workers, look_at

SIZE = 0.5  # m
CAMERA = look_at((0, -1, 0), (0, 0, 0), width=32, height=32, vertical_field_of_view=0.5)


def capture(tmp_path, *cameras):
    for camera in cameras:
        (tmp_path / f"{camera.name}.mp4").touch()
    return Capture(tmp_path, 24.0, 4, 3, cameras)


def range_of(tmp_path, **options):
    return scan_range(RefinementRun(capture(tmp_path, CAMERA), RefineOptions(**options)), SIZE)


def answer(low, high, ratio=0.4):
    middle = (low * high) ** 0.5
    return SimpleNamespace(
        youngs_modulus=middle,
        youngs_modulus_interval=(low, high),
        poisson_ratio=ratio,
        poisson_ratio_interval=(0.2, 0.45),
    )


def predicts(monkeypatch, answer, place="cpu"):
    def predict(path, checkpoint, device):
        assert device == place
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr("inference.predictor.predict", predict)


def test_the_scan_covers_the_predicted_interval(monkeypatch, tmp_path):
    predicts(monkeypatch, answer(1e4, 1e6))
    where = range_of(tmp_path, start="predict")
    np.testing.assert_allclose(where.moduli, [4, 4.5, 5, 5.5, 6])
    assert where.ratios == (0.4, 0.3) and where.predicted == (4.0, 6.0) and where.note == ""


def test_the_network_predicts_on_the_device_that_is_asked_for(monkeypatch, tmp_path):
    predicts(monkeypatch, InputError("was asked"), place="meta")
    assert "was asked" in range_of(tmp_path, device="meta").note


def test_what_the_prediction_leaves_out_is_scanned_coarsely(monkeypatch, tmp_path):
    """A prediction that was a decade off led a hammer's fit to 1.7 decades from the truth."""
    predicts(monkeypatch, answer(1e5, 1e6))
    where = range_of(tmp_path)
    everywhere = range_of(tmp_path, start="scan").moduli
    beyond = [value for value in everywhere if not 4.8 <= value <= 6.2]
    assert len(beyond) >= 4 and set(beyond) < set(where.moduli)
    assert sum(5 <= value <= 6 for value in where.moduli) == 5 and len(where.moduli) == 5 + len(beyond)


def test_a_start_within_the_prediction_is_kept():
    found = [Candidate(value, 0.3, misfit, ()) for misfit, value in enumerate((3.9, 6.6, 5.2, 5.0))]
    kept = arrays_of_scan(found, within=(5.0, 6.0))["starts"], arrays_of_scan(found, within=(3.5, 4.5))["starts"]
    assert [len(starts) for starts in kept] == [3, 2]


def test_an_overconfident_interval_is_widened(monkeypatch, tmp_path):
    predicts(monkeypatch, answer(1e5, 1e5, 0.3))
    where = range_of(tmp_path, start="predict")
    np.testing.assert_allclose((where.moduli[0], where.moduli[-1]), [4.6, 5.4])
    assert where.ratios == (0.3, 0.45)


def test_without_a_prediction_the_whole_range_is_scanned_and_that_is_said(monkeypatch, tmp_path):
    predicts(monkeypatch, InputError("no video"))
    where = range_of(tmp_path)
    assert "no video" in where.note and where.moduli[-1] - where.moduli[0] > 3.5
    # E/(ρ g L) from about 0.5 on
    assert where.moduli[0] == pytest.approx(np.log10(0.5 * 1000 * 9.81 * 0.5), abs=0.01)
    with pytest.raises(InputError, match="no video"):
        range_of(tmp_path, start="predict")
    assert scan_range(RefinementRun(capture(tmp_path)), SIZE).note == ""


def free_parameters(**ratio):
    parameters = [default_parameter(name) for name in ("log10_youngs_modulus", "poisson_ratio")]
    return parameters[0], replace(parameters[1], **ratio)


def fit_at(*values):
    return Fit(free_parameters(), np.array(values), *[np.zeros(0)] * 4, (), True, 1)


@pytest.mark.wrong_types
def test_the_network_s_ratio_is_held_unless_the_user_has_one(monkeypatch, tmp_path):
    predicts(monkeypatch, answer(1e5, 1e6, 0.4))
    run = RefinementRun(capture(tmp_path, CAMERA), stages=Stages(tmp_path / "out"))
    problem = Problem(None, free_parameters(), None)
    assert with_predicted_ratio(run, problem) == (problem, None)  # the search has not asked the network
    predicted(run)
    held, sigma = with_predicted_ratio(run, problem)
    ratio = held.parameters[1]
    assert sigma == pytest.approx(0.25 / 3.29, rel=1e-3) and ratio.start == ratio.prior_mean == 0.4
    assert ratio.at(0.1).start == pytest.approx(0.4, abs=0.01) and held.parameters[0] == problem.parameters[0]
    assert "0.40 ± 0.08, and is not fitted" in run.warnings[0]
    theirs = Problem(None, free_parameters(prior_mean=0.3, prior_sigma=0.1), None)
    assert with_predicted_ratio(run, theirs) == (theirs, None)
    fixed = Problem(None, free_parameters()[:1], None)
    assert with_predicted_ratio(run, fixed) == (fixed, None)
    moved, (other,) = moved_inside(held.parameters, fit_at(5.0, 0.0), [np.array([6.0, 0.49])])
    assert moved.values == pytest.approx([5.0, 0.395]) and other == pytest.approx([6.0, 0.405])


@pytest.mark.wrong_types
def test_the_first_candidate_is_begun_with_if_it_is_the_best(monkeypatch):
    """It is the convex twin's, not the reduced model's fit."""
    values = (np.array([6.0, 0.4]), np.array([5.0, 0.3]))
    monkeypatch.setattr(coarse_start, "misfits_of", lambda problem, model, candidates: np.array([1.0, 2.0]))
    run = RefinementRun(None)
    start = coarse_start._best(run, None, None, None, fit_at(*values[1]), values)
    assert np.array_equal(start.values, values[0])


@pytest.mark.wrong_types
@pytest.mark.parametrize("limit", [None, (2, 0.01)])
def test_late_frames_do_not_decide_between_starts(monkeypatch, limit):
    """A mug's search went on from a modulus half a decade off, which was nearer late after the rebound only."""
    rng, sigma = np.random.default_rng(5), 1e-3
    rest, late = rng.uniform(size=(20, 3)), np.arange(8) >= 6
    bent = rng.standard_normal((20, 3))
    at = {
        "near early": rest + (20 * sigma * late)[:, None, None] * bent,
        "near late": rest + np.where(late, 0.5 * sigma, 3 * sigma)[:, None, None] * bent,
    }
    still = np.broadcast_to(rest, (8, 20, 3))
    seen = MarkerObservations(rest, still, np.full((8, 20), sigma))
    twin, observed = SimpleNamespace(fps=24.0), SimpleNamespace(observations=seen)
    problem = Problem(twin, (), observed, drift_limit=limit)  # type: ignore[arg-type]
    monkeypatch.setattr(coarse_start, "roll_out_together", list)
    values = [np.array([0.0]), np.array([1.0])]
    memory = SimpleNamespace(workers=Workers())
    half = SimpleNamespace(positions=lambda v: list(at.values())[int(v[0])], memory=memory)
    other = SimpleNamespace(positions=lambda v: at["near early"] + (80 * sigma * late)[:, None, None] * bent)

    def best(other):
        return coarse_start._best(RefinementRun(None), problem, half, other, fit_at(*values[0]), values).values

    assert best(None) == values[1] and best(other) == values[0]


def test_options_are_checked():
    for bad, message in (
        ({"weights": 0}, "weights: got 0"),
        ({"steps_per_frame": 0}, "at least 1"),
        ({"processes": 0}, "processes: got 0"),
        ({"fixed": {"poisson_ratio": None}}, "needs a value"),
        ({"pixels": ()}, "pixels: got .*one or more ascending numbers, from 8 on"),
        ({"pixels": (4, 24)}, "from 8 on"),
        ({"pixels": (48, 24)}, "ascending"),
    ):
        with pytest.raises(InputError, match=message):
            RefineOptions(**bad)
    assert RefineOptions(priors={"poisson_ratio": (0.4, 0.1)}).to_json()["priors"] == {"poisson_ratio": [0.4, 0.1]}


@pytest.mark.wrong_types
def test_choices_are_checked():
    with pytest.raises(InputError, match="expected one of"):
        RefineOptions(start="guess")


def test_no_processes_are_refused_by_the_command_too(tmp_path):
    app = typer.Typer()
    app.command()(refine_command)
    found = CliRunner().invoke(app, ["examples/captures/school_bus", "--processes", "0", "--out", str(tmp_path)])
    assert isinstance(found.exception, InputError) and "processes: got 0" in str(found.exception)


@pytest.mark.wrong_types
def test_the_floor_s_height_is_free_for_a_body_from_pictures_unless_the_user_holds_it(monkeypatch):
    monkeypatch.setattr(reduced_search, "parameter_values", lambda scene, names: np.array([0.2]))
    problem = Problem(SimpleNamespace(may_strike=True, scene=None), free_parameters(), None)
    made = SimpleNamespace(error=SimpleNamespace(deviation=0.007))

    def of(reconstruction, options):
        run = SimpleNamespace(reconstruction=reconstruction, options=options)
        return with_free_height(run, problem)

    free = of(made, RefineOptions()).parameters[-1]
    assert (free.name, free.start, free.prior_mean, free.prior_sigma) == ("floor_height", 0.2, 0.2, 0.007)
    assert of(made, RefineOptions(fixed={"floor_height": None})) is problem
    assert of(None, RefineOptions()) is problem  # a given body
    start, (other,) = moved_inside((*problem.parameters, free), fit_at(5.0, 0.3), [np.array([6.0, 0.4])])
    assert start.values == pytest.approx([5.0, 0.3, 0.2]) and other == pytest.approx([6.0, 0.4, 0.2])
