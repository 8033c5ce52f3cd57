"""Colours that lose a body after a contact, and where the search begins again."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from inference import RefinementRun
from inference.refinement import colour_search
from inference.refinement.colour_search import blur_for, colours_lost, materials_about
from inference.refinement.problem import HELD
from physconvex.identify import ColourObservations, StackedObservations, default_parameter
from physconvex.io import look_at

pytestmark = pytest.mark.wrong_types  # stand-ins for problems and fits
NAMES = ("log10_youngs_modulus", "poisson_ratio", "damping_time")


class Twin:
    density = 1000.0
    mesh = SimpleNamespace(size=0.5)

    def with_values(self, names, values):
        by_name = dict(zip(names, values, strict=True))
        return SimpleNamespace(scene=(10 ** by_name["log10_youngs_modulus"], self.density))


@pytest.fixture
def problem(monkeypatch):
    monkeypatch.setattr(
        "inference.refinement.problem.parameter_values", lambda scene, names: [np.log10(scene[0]), scene[1]]
    )
    unknown = tuple(default_parameter(name) for name in NAMES)
    return SimpleNamespace(parameters=unknown, twin=Twin())


def found_at(values, names=NAMES):
    return SimpleNamespace(names=names, values=np.array(values), positions=None)


def test_other_rebounds_are_sought_by_modulus_ratio_and_damping(problem):
    values = np.array(materials_about(problem, found_at([6.0, 0.1, 2e-4])))
    assert values[0].tolist() == [6.0, 0.1, 2e-4] and len(values) == 1 + 3 * 2 * 3
    assert len(np.unique(values, axis=0)) == len(values)
    assert sorted({round(v, 2) for v in values[1:, 0]}) == [5.92, 6.0, 6.08]
    # the slowest wave: √(1e6 / 1000) / 0.5 / 2 = 31.6 Hz, 199 rad/s
    np.testing.assert_allclose(sorted(set(values[1:, 2].round(7))), [2e-4, 0.1 / 198.7, 0.3 / 198.7], rtol=1e-3)


def test_what_is_fixed_stays(problem):
    problem.parameters = problem.parameters[:2]
    values = np.array(materials_about(problem, found_at([6.0, 0.1], NAMES[:2])))
    assert values.shape == (1 + 3 * 2, 2)


def test_a_ratio_that_is_held_is_not_varied(problem):
    modulus, ratio, damping = problem.parameters
    problem.parameters = modulus, replace(ratio, prior_mean=0.38, prior_sigma=HELD * ratio.step), damping
    values = np.array(materials_about(problem, found_at([6.0, 0.38, 2e-4])))
    assert len(values) == 1 + 3 * 3 and set(values[:, 1]) == {0.38}


def test_the_damping_stays_within_its_bounds(problem):
    values = np.array(materials_about(problem, found_at([3.0, 0.1, 0.0])))
    assert values[:, 2].max() <= problem.parameters[2].upper


@pytest.mark.parametrize("moved", [0.0, 0.03])
def test_colours_are_lost_where_they_lie_elsewhere_after_the_contact(moved):
    rng = np.random.default_rng(0)
    camera = look_at([0.0, -1.0, 0.0], [0.0, 0.0, 0.0], width=64, height=64, vertical_field_of_view=0.5, name="a")
    points = rng.uniform(-0.1, 0.1, size=(60, 3)) * [1.0, 0.0, 1.0]
    picture = np.tile(np.linspace(0, 1, 64)[None, :, None], (64, 1, 3))
    images = np.stack([picture] * 4) + rng.normal(scale=0.002, size=(4, 64, 64, 3))
    colours = ColourObservations(camera, points, images, np.ones((4, 60), bool), exposure=False)
    stack = StackedObservations((colours,))
    positions = np.tile(points, (4, 1, 1))
    positions[2:, :, 0] += moved
    problem = SimpleNamespace(
        seen=stack, observed=SimpleNamespace(observations=stack), drift_limit=(2, 0.1), parameters=()
    )
    lost = colours_lost(problem, SimpleNamespace(positions=positions))
    assert lost == pytest.approx(1.0, abs=0.2) if moved == 0 else lost > colour_search._LOST
    problem.drift_limit = None
    assert colours_lost(problem, SimpleNamespace(positions=positions)) == 1.0
    problem.drift_limit = (1, 0.1)  # struck at once: nothing to compare with
    assert colours_lost(problem, SimpleNamespace(positions=positions)) == 1.0


@pytest.mark.parametrize(("astray", "blur"), [(0.0, 1.5), (0.008, 2.0), (0.012, 3.0), (0.5, 6.0)])
def test_colours_are_blurred_as_wide_as_the_model_is_astray_in_the_nearest_camera(astray, blur):
    near, far = (
        look_at([0.0, -y, 0.0], [0.0, 0.0, 0.0], width=256, height=256, vertical_field_of_view=0.5, name="a")
        for y in (2.0, 9.0)
    )
    assert near.fl_x / 2.0 == pytest.approx(250, rel=0.01)  # pixels per metre
    body = SimpleNamespace(mesh=SimpleNamespace(vertices=np.zeros((3, 3))))
    problem = SimpleNamespace(twin=body, observed=SimpleNamespace(cameras=(far, near)), astray=astray)
    assert blur_for(problem) == blur


@pytest.mark.parametrize(("best", "after"), [(0, None), (2, 1.5), (2, 40.0)])
def test_the_material_that_wide_colours_like_best_is_kept_where_it_follows_the_body_better(best, after, monkeypatch):
    monkeypatch.setattr(colour_search, "blur_for", lambda problem: 1.5)
    monkeypatch.setattr(colour_search, "materials_about", lambda problem, found: ["here", "there", "best"])
    monkeypatch.setattr(colour_search, "colours_lost", lambda problem, found: {"again": after}[found.name])
    monkeypatch.setattr(colour_search, "replace", lambda fit, values: SimpleNamespace(name="moved", values=values))
    fitted = []
    misfits = np.where(np.arange(3) == best, 1.0, 5.0)
    stages = SimpleNamespace(run=lambda name, compute: {"misfits": misfits})

    def fit_to(run, problem, found, blur, name):
        fitted.append((found.values, blur, name))
        return "again", SimpleNamespace(name="again", values=f"fitted at {blur:g}")

    monkeypatch.setattr(colour_search, "_fitted", fit_to)
    run, first = RefinementRun(None, stages=stages), SimpleNamespace(name="first")
    kept, found = colour_search._restarted(run, "problem", "kept", first, lost=20.0)
    if best == 0:
        assert (kept, found) == ("kept", first) and not fitted
        return
    assert fitted == [("best", 6.0, "_elsewhere"), ("fitted at 6", 1.5, "_elsewhere")]
    assert (kept, found.name) == (("again", "again") if after < 20 else ("kept", "first"))
