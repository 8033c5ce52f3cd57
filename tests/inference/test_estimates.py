"""A fit judged by a finer model."""

from types import SimpleNamespace

import numpy as np
import pytest

from inference.refining import RefineOptions, estimates

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
