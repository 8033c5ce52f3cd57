"""The numerical error that is believed: no larger than what some fit leaves, with a margin."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import ErrorModel
from physconvex.gap.base.baseline import Split
from physconvex.gap.base.body_modes import BodyModes, undivided
from physconvex.gap.errors.error_model import error_scale

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits

FRAMES, EACH = 12, 60
SIZE = np.repeat(np.r_[np.zeros(6), np.full(6, 20.0)], EACH)  # of the numerical error over noise


def case(residual, size=SIZE, fitted=FRAMES):
    """A baseline with one nuisance, and what other meshes lead one to expect of its residuals."""
    count = FRAMES * EACH
    frames = np.repeat(np.arange(FRAMES), EACH)
    base = SimpleNamespace(
        split=Split(np.arange(fitted), np.arange(fitted, FRAMES), np.arange(0)),
        observations=SimpleNamespace(frames=frames),
        modes=undivided(frames),
        positions=np.zeros((FRAMES, EACH // 3, 3)),
        tangents=np.ones((FRAMES, 1, EACH // 3, 3)),
        rows=lambda fitted: np.flatnonzero(np.isin(frames, fitted)),
        change=lambda positions: positions.reshape(-1),
        residual=lambda positions: residual,
    )
    return base, ErrorModel(1 + size**2, np.zeros((0, count)), 1 + size**2)


def screened(signature, source="material", amount=1.0):
    effect = SimpleNamespace(source=source)
    score = SimpleNamespace(amounts=np.array([amount]))
    entry = SimpleNamespace(effect=effect, score=score, signature=signature.reshape(1, FRAMES, EACH // 3, 3))
    return SimpleNamespace(one_per_name=(entry,))


NOTHING = SimpleNamespace(one_per_name=())


@pytest.mark.parametrize(("share", "scale"), [(1.0, 1.0), (0.3, 0.3 * 2), (0.02, 0.15)])
def test_a_residual_below_the_expected_error_bounds_it(rng, share, scale):
    residual = rng.normal(size=len(SIZE)) * np.sqrt(1 + (share * SIZE) ** 2)
    np.testing.assert_allclose(error_scale(*case(residual), NOTHING), scale, rtol=0.1)


def test_what_an_effect_explains_is_no_error(rng):
    hidden = 15.0 * rng.normal(size=len(SIZE)) * (SIZE > 0)
    base, errors = case(hidden + rng.normal(size=len(SIZE)) * np.sqrt(1 + (0.1 * SIZE) ** 2))
    assert (error_scale(base, errors, NOTHING) == 1.0).all()
    np.testing.assert_allclose(error_scale(base, errors, screened(hidden)), 0.1 * 2, rtol=0.2)
    assert (error_scale(base, errors, screened(hidden, source="numerical")) == 1.0).all()
    assert (error_scale(base, errors, screened(hidden, amount=0.0)) == 1.0).all()  # the sign that physics forbids


def test_later_frames_are_trusted_by_what_the_base_model_leaves_there(rng):
    """The fitted frames err as expected, the later ones by a fifth of it; and the other way round."""
    late = np.repeat(np.arange(FRAMES) >= 9, EACH)
    noise = rng.normal(size=len(SIZE))
    residual = noise * np.sqrt(1 + (np.where(late, 0.2, 1.0) * SIZE) ** 2)
    scale = error_scale(*case(residual, fitted=9), NOTHING)
    assert (scale[~late] == 1.0).all()
    np.testing.assert_allclose(scale[late], 0.2 * 2, rtol=0.15)
    residual = noise * np.sqrt(1 + (np.where(late, 1.0, 0.2) * SIZE) ** 2)
    np.testing.assert_allclose(error_scale(*case(residual, fitted=9), NOTHING), 0.2 * 2, rtol=0.15)


def test_frames_without_numerical_error_tell_nothing(rng):
    residual = rng.normal(size=len(SIZE))
    assert (error_scale(*case(residual, 0.5 * np.ones(len(SIZE))), NOTHING) == 1.0).all()


def test_each_kind_of_residual_is_trusted_by_itself(rng):
    """A rebound that is off by all that is expected does not make the strains uncertain."""
    kinds = np.tile(np.repeat([0, 1], EACH // 2), FRAMES)
    share = np.where(kinds == 0, 1.0, 0.1)
    base, errors = case(rng.normal(size=len(SIZE)) * np.sqrt(1 + (share * SIZE) ** 2))
    base.modes = BodyModes(base.observations.frames, kinds, (6.0, 6.0))
    scale = error_scale(base, errors, NOTHING)
    assert (scale[kinds == 0] == 1.0).all()
    np.testing.assert_allclose(scale[kinds == 1], 0.1 * 2, rtol=0.15)
