"""A fit judged by a finer model."""

from types import SimpleNamespace

import numpy as np
import pytest

from inference.refining import RefineOptions, estimates
from physconvex.fem import box_mesh, filled

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits


@pytest.mark.parametrize("strikes", [True, False])
@pytest.mark.parametrize("away", [True, False])
def test_a_finer_model_that_runs_away_is_not_followed(away, strikes, monkeypatch):
    """A lion on its legs, whose ν a finer mesh drove from .29 to its bound; the interval takes that in."""
    found, last = (SimpleNamespace(values=np.array(v), parameters=()) for v in ([6.67, 0.29], [6.63, 0.0]))
    arrays = {
        "values": last.values,
        "left": np.array([0.003, 0.004]),
        "errors": np.zeros(3),
        "runs_away": np.array(away),
    }
    monkeypatch.setattr(estimates, "finer_mesh", lambda twin: "mesh")
    monkeypatch.setattr(estimates, "fit_of", lambda arrays, parameters: last)
    full, warnings = SimpleNamespace(twin=SimpleNamespace(may_strike=strikes), frames=3), []
    stages = SimpleNamespace(run=lambda name, compute: arrays)
    judged = estimates.judge(full, found, None, RefineOptions(), stages, warnings)
    assert judged.fit is (found if away else last) and judged.mesh == "mesh"
    assert len(warnings) == away
    wide = away or strikes
    assert judged.left == pytest.approx(np.hypot(arrays["left"], [0.04, 0.29]) if wide else arrays["left"])


@pytest.mark.parametrize("fill", [True, False])
def test_a_finer_mesh_is_filled_where_the_coarse_one_is(fill, monkeypatch):
    surface = box_mesh((0.3, 0.2, 0.2), (2, 1, 1), order=1).surface
    coarse, fine = box_mesh((0.3, 0.2, 0.2), (2, 1, 1)), box_mesh((0.3, 0.2, 0.2), (4, 2, 2))
    shown = SimpleNamespace(vertices=surface[0], faces=surface[1])
    capture = SimpleNamespace(mesh=lambda: shown, tets=lambda: None)
    monkeypatch.setattr(estimates, "faithful_mesh", lambda *surface, max_nodes: fine)
    found = estimates.finer_mesh(SimpleNamespace(capture=capture, mesh=filled(coarse, *surface) if fill else coarse))
    assert np.array_equal(found.vertices, fine.vertices)
    assert (found.filling is not None) == fill


def test_the_noise_of_images_is_what_their_residuals_are_and_that_of_markers_at_least_as_stated():
    rng = np.random.default_rng(0)
    markers, colours = slice(0, 4000), slice(4000, 10_000)

    def variances(of_markers, of_colours, stated=(True, False)):
        residuals = rng.normal(size=10_000)
        residuals[markers] *= of_markers
        residuals[colours] *= of_colours
        found = SimpleNamespace(residuals=residuals, reduced_chi_square=float(np.mean(residuals**2)))
        return estimates._variances(found, (markers, colours), stated)

    told = variances(0.5, 0.1)
    assert told[markers] == pytest.approx(1.0) and told[colours] == pytest.approx(0.01, rel=0.1)
    assert variances(0.5, 0.1, (False, False))[markers] == pytest.approx(0.25, rel=0.1)
    assert variances(3.0, 0.1) == pytest.approx(9.0, rel=0.1)  # what is not followed is not hidden by the rest
