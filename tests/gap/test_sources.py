"""The parts of a gap add up, and each effect's share goes to its source."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, ErrorModel, MotionCorrection, PointMotion
from physconvex.gap.location.sources import budget_of, reduction_by_frame
from physconvex.identify import MarkerObservations

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits

FRAMES, POINTS, SIGMA = 6, 400, 1e-4
LATE = next(e for e in DEFAULT_EFFECTS if e.name == "time_offset")
DRAG = next(e for e in DEFAULT_EFFECTS if e.label == "air_drag (linear)")
STEP = next(e for e in DEFAULT_EFFECTS if e.name == "time_step")


@dataclass(frozen=True)
class FakeModel:
    """Observation as in `EffectModel`, and no simulator."""

    effects: tuple = ()
    correction: MotionCorrection | None = None
    frames: int = FRAMES
    directions: tuple = ()

    @property
    def slices(self):
        return tuple(slice(i, i + 1) for i in range(len(self.effects)))

    def observed(self, motion, values):
        positions = (motion if self.correction is None else self.correction.of(motion)).positions
        for effect, where in zip(self.effects, self.slices, strict=True):
            if effect.observe is not None:
                positions = effect.observe(replace(motion, positions=positions), values[where])
            if effect.name in dict(self.directions):
                positions = positions + values[where][0] * dict(self.directions)[effect.name]
        return positions


def falling(rest, times, acceleration):
    fall, since = np.array([0.0, 0, -0.5 * acceleration]), times[:, None, None]
    return PointMotion(rest, times, rest + since**2 * fall, np.broadcast_to(2 * since * fall, (FRAMES, POINTS, 3)))


def case(seen, motion, best, *, expected=1.0, directions=()):
    """Base and best fit; `seen` [T, P, 3]."""
    observations = MarkerObservations(motion.rest, seen, np.full(seen.shape[:2], SIGMA))
    count = len(observations.frames)
    base = SimpleNamespace(
        observations=observations,
        model=FakeModel(directions=dict(directions)),
        components=3,
        lengths=np.full(count, SIGMA),
        motion=motion,
        positions=motion.positions,
        missed=lambda positions: -observations.residuals(positions) * SIGMA,
    )
    return base, ErrorModel(np.full(count, expected), np.zeros((0, count))), best


def hypothesis(motion, *pairs, directions=()):
    model = FakeModel(tuple(e for e, _ in pairs), directions=tuple(directions))
    values = np.array([dose for _, dose in pairs])
    return SimpleNamespace(
        model=model, values=values, motion=motion, effects=model.effects, positions=model.observed(motion, values)
    )


@pytest.fixture
def drop(rng):
    rest, times = rng.uniform(size=(POINTS, 3)), np.arange(FRAMES) / 24
    return falling(rest, times, 9.81), falling(rest, times, 9.0)


def parts(budget):
    return [float(np.nanmean(squares)) for squares in budget.values()]


def test_each_effect_goes_to_its_source_and_all_adds_up(drop, rng):
    plain, dragged = drop
    best = hypothesis(dragged, (DRAG, 0.4), (LATE, -0.01))
    seen = best.positions + SIGMA * rng.normal(size=best.positions.shape)
    base, errors, best = case(seen, plain, best)
    budget = budget_of(base, errors, best)
    noise, numerical, geometry, observation, dynamics, unexplained = parts(budget)
    total = (base.missed(plain.positions) ** 2).sum() / (FRAMES * POINTS)
    assert sum(parts(budget)) == pytest.approx(total, rel=1e-3)
    assert noise == pytest.approx(3 * SIGMA**2, rel=0.1)
    assert min(observation, dynamics) > 0.2 * total
    assert max(numerical, geometry, unexplained) < 1e-3 * total
    alone = budget_of(*case(dragged.positions, plain, hypothesis(dragged, (DRAG, 0.4))))
    assert parts(alone)[3] == 0 and parts(alone)[4] > 0


def test_shares_do_not_depend_on_the_order_of_effects(drop):
    plain, dragged = drop
    first, second = hypothesis(dragged, (DRAG, 0.4), (LATE, -0.01)), hypothesis(dragged, (LATE, -0.01), (DRAG, 0.4))
    one, other = (parts(budget_of(*case(first.positions, plain, h))) for h in (first, second))
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_of_two_that_work_against_each_other_one_has_no_share(drop, rng):
    plain, dragged = drop
    best = hypothesis(dragged, (DRAG, 0.4), (LATE, 0.003))
    seen = best.positions + SIGMA * rng.normal(size=best.positions.shape)
    base, errors, best = case(seen, plain, best)
    found = parts(budget_of(base, errors, best))
    assert found[3] < 0.01 * found[4]  # what it explains of the first frames, where the other does nothing yet
    assert sum(found) == pytest.approx((base.missed(plain.positions) ** 2).sum() / (FRAMES * POINTS), rel=1e-3)


def test_a_numerical_effect_is_discretisation(drop):
    plain, slower = drop
    directions = (("time_step", slower.positions - plain.positions),)
    best = hypothesis(plain, (STEP, 1.0), directions=directions)
    found = parts(budget_of(*case(slower.positions, plain, best)))
    assert found[1] > 0
    assert found[2:5] == [0, 0, 0]


def test_what_the_first_frame_is_off_by_is_geometry(drop, rng):
    plain, _ = drop
    seen = plain.positions + 2e-3 * rng.normal(size=(POINTS, 3))
    found = parts(budget_of(*case(seen, plain, hypothesis(plain))))
    assert found[2] == pytest.approx(3 * 4e-6, rel=0.2)
    assert max(found[1], found[3], found[4], found[5]) < 1e-9


def test_what_is_left_is_numerical_as_far_as_that_is_expected(drop):
    plain, other = drop
    found = parts(budget_of(*case(other.positions, plain, hypothesis(plain), expected=1e4)))
    assert found[1] > 0 and found[5] > 0
    assert found[2:5] == [0, 0, 0]


def test_reduction_is_told_beside(drop):
    plain, other = drop
    base, _, _ = case(other.positions, plain, hypothesis(plain))
    assert reduction_by_frame(base) is None
    missed = other.positions - plain.positions
    with_reduction = SimpleNamespace(model=replace(base.model, directions={"reduction": missed}))
    np.testing.assert_allclose(reduction_by_frame(with_reduction), (missed**2).sum(-1).mean(1))
