"""The base model at its first frames."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, ErrorModel, GapOptions, rough_baseline
from physconvex.gap.search.starting_points import early_point, early_window

OPTIONS = GapOptions(max_nodes=60, weights=4, iterations=6)
COUNT = 20  # frames that are fitted, which derivatives are known of


@pytest.fixture(scope="module")
def rough(released, tmp_path_factory):
    """A beam that is let go, at its fit."""
    capture = released(tmp_path_factory.mktemp("anchoring"), 0.0)
    return rough_baseline(capture, OPTIONS, lambda text: None)


def at(base, change, *effects):
    """The baseline with E so many decades off, with effects at their null doses."""
    model = replace(base.model, effects=effects)
    values = np.concatenate(
        [base.fit.values + np.array([change, 0.0, 0.0])[: len(base.fit.values)], *(e.null for e in effects)]
    )
    motion = model.motion(values)
    tangents = replace(model, frames=COUNT).linearise(values, motion.first(COUNT))[1]
    fit = replace(base.fit, parameters=model.parameters(values), values=values)
    return replace(base, model=model, fit=fit, motion=motion, tangents=tangents)


@pytest.mark.slow
@pytest.mark.parametrize("names", [(), ("gravity_tilt",)])
def test_the_first_frames_bring_the_modulus_back(rough, names):
    """Also beside an effect, whose doses they are fitted with."""
    effects = tuple(e for e in DEFAULT_EFFECTS if e.name in names)
    count = len(rough.residual(rough.positions))
    errors = ErrorModel(np.ones(count), np.zeros((0, count)))
    base = at(rough, 0.2, *effects)
    assert early_window(base, errors) <= 0.75 * COUNT
    point = early_point(base, errors, OPTIONS, lambda text: None)
    assert point.fit.values[0] == pytest.approx(rough.fit.values[0], abs=0.05)
    assert point.fit.values[0] == pytest.approx(np.log10(2e5), abs=0.15)
    assert point.model.effects == effects
