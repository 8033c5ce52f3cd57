"""A fit of a held body ends where the recording says, wherever it begins."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physconvex.capture import Capture
from physconvex.gap import DEFAULT_EFFECTS, GapOptions
from physconvex.gap.base.base_fit import rough_baseline
from physconvex.gap.errors.numerics import Numerics, error_model
from physconvex.gap.search.comparison import refit

OPTIONS = GapOptions(max_nodes=100, weights=4)
RATIO = 0.3


@pytest.mark.slow
@pytest.mark.parametrize("off", [-0.1, 0.1])
def test_a_far_start_does_not_decide_where_a_fit_ends(
    released: Callable[[Path, float], Capture], tmp_path: Path, off: float
) -> None:
    """Priors weighed by what the start left, hundreds of times what the end leaves, held ν, and E with it."""
    rough = rough_baseline(released(tmp_path, RATIO), OPTIONS, lambda text: None)
    still = np.zeros_like(rough.motion.positions)
    errors = error_model(rough, Numerics(still, still, still, still, still), OPTIONS)
    load = next(effect for effect in DEFAULT_EFFECTS if effect.label == "attached_mass (-x)")
    model = replace(rough.model, effects=(load,), reduced=False)
    start = np.array([*rough.fit.values, RATIO, 0.0])
    start[0] = np.log10(2e5) + off
    motion = model.motion(start)
    found = refit(rough, errors, model, start, model.tangents(start, motion), OPTIONS)
    assert found.fitted < 10 and found.selecting < 10  # 60 and 20 before; what is left is the coarse mesh
    assert found.values[:3] == pytest.approx([5.33, 0.34, 0.36], abs=0.01)  # from either start
