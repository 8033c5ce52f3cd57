"""How fits compare: how much a likelihood counts, and where a fit begins."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, ErrorModel, Hypothesis
from physconvex.gap.base.baseline import Split
from physconvex.gap.base.body_modes import BodyModes, undivided
from physconvex.gap.search.effect_fits import _beside, _best_start
from physconvex.gap.search.evidence import (
    evidence_of,
    information_per_one,
    likelihood_by_kind,
    mean_square,
    moved_kinds,
)
from physconvex.gap.search.hypothesis import doses_at_bounds

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits

FRAMES, POINTS = 15, 40


def case(residual, numerical):
    """A baseline whose residuals are these, and their errors: noise, and a numerical one that counts as a few."""
    count = FRAMES * POINTS * 3
    frames = np.repeat(np.arange(FRAMES), POINTS * 3)
    base = SimpleNamespace(
        split=Split(np.arange(12), np.arange(12, FRAMES), np.arange(0)),
        observations=SimpleNamespace(frames=frames),
        modes=undivided(frames),
        columns=np.tile(np.arange(POINTS * 3), FRAMES),
        model=SimpleNamespace(frames=FRAMES),
        rows=lambda chosen: np.flatnonzero(np.isin(frames, chosen)),
        residual=lambda positions: residual,
    )
    errors = ErrorModel(np.full(count, 1 + 20 * numerical), np.zeros((0, count)), np.full(count, 1 + numerical))
    return base, errors


def counted(residual, numerical):
    """Residuals that the likelihood counts."""
    base, errors = case(residual, numerical)
    information = FRAMES * (POINTS * 3 / (1 + 20 * numerical) + 3 if numerical else POINTS * 3)
    return information / information_per_one(base, errors, np.zeros(0)).item()


@pytest.fixture
def smooth():
    """One shape that swings slowly, thrice as large as what is expected."""
    moments = np.sin(np.arange(FRAMES) / 2.0)[:, None] * np.linspace(-1, 1, POINTS * 3)
    return 3 * (moments / moments.std()).ravel()


def test_noise_counts_whole(rng):
    noise = rng.normal(size=FRAMES * POINTS * 3)
    noise /= np.sqrt(np.mean(noise**2))  # as large as expected: a hundredth more would count as lack of fit
    assert counted(noise, 0.0) == pytest.approx(FRAMES * POINTS * 3, rel=0.05)


def test_a_smooth_lack_of_fit_counts_as_the_independent_ones_among_it(smooth):
    few = counted(smooth, 0.0)
    assert 3 < few < 12


def test_what_numerical_error_has_made_few_is_not_made_fewer_for_the_same_reason(smooth):
    """The likeness of residuals was counted twice: their number by frame, and again that number by what is left."""
    whitened = smooth * np.sqrt(2.0)  # the same over what is now expected
    assert counted(whitened, 1.0) == pytest.approx(counted(smooth, 0.0), rel=1e-6)
    assert counted(0.3 * whitened, 1.0) == pytest.approx(FRAMES * (POINTS * 3 / 21 + 3), rel=1e-6)


def test_other_values_go_where_the_screened_dose_puts_them(rng):
    """r = S d + J p: where the dose is given in full, the rest is p."""
    shape = (FRAMES, 1, POINTS, 3)
    moved, stretched = rng.normal(size=shape), rng.normal(size=shape)
    signature = 2.0 * stretched[:, 0] + 1.5 * moved[:, 0]  # of the trial dose; most of it looks like another E
    base, errors = case(np.zeros(FRAMES * POINTS * 3), 0.0)
    base.positions, base.tangents = np.zeros((FRAMES, POINTS, 3)), moved
    base.change = lambda positions: np.concatenate([positions, base.positions[len(positions) :]]).ravel()
    seen = 0.7 * signature + 0.12 * moved[:, 0]
    base.residual = lambda positions: (seen - positions).ravel()
    parameter = SimpleNamespace(step=0.1, lower=3.0, upper=8.0)
    base.fit = SimpleNamespace(values=np.array([5.0]))
    base.model.parameters = lambda values: (parameter,)
    entry = SimpleNamespace(score=SimpleNamespace(amounts=np.array([0.7])), signature=signature[None])
    assert _beside(base, errors, base, [entry]) == pytest.approx([5.12])
    none = SimpleNamespace(score=SimpleNamespace(amounts=np.array([0.0])), signature=signature[None])
    assert 5.12 < _beside(base, errors, base, [none])[0] <= 5.5  # E alone takes it, at most five typical steps


def likelihood(base, errors):
    """Of the fitted frames and of those that choose, by kind."""
    parts = (base.split.fitted, base.split.selecting)
    return sum(likelihood_by_kind(base, errors, np.zeros(0), frames) for frames in parts)


def worth_of_good_strains(noise, rebound, modes):
    """Log-likelihood that a model gains whose strains err as expected, over one that errs by twice that."""
    kinds = np.tile(np.repeat([0, 1], [6, POINTS * 3 - 6]), FRAMES)
    good, poor = (case(noise * np.where(kinds == 0, rebound, strains), 0.0) for strains in (1.0, 2.0))
    for base, _ in (good, poor):
        base.modes = modes(base.observations.frames, kinds)
    divisor = information_per_one(*good, np.zeros(0))
    return float(((likelihood(*good) - likelihood(*poor)) / divisor).sum())


def test_a_rebound_that_is_off_does_not_drown_what_the_strains_say(rng):
    noise = rng.normal(size=FRAMES * POINTS * 3)
    sound, off = (
        worth_of_good_strains(noise, rebound, lambda frames, kinds: BodyModes(frames, kinds, (6.0, 12.0)))
        for rebound in (1.0, 100.0)
    )
    assert off == pytest.approx(sound, rel=1e-9) and sound > 100
    assert worth_of_good_strains(noise, 100.0, lambda frames, kinds: undivided(frames)) < 0.1 * sound


@dataclass(frozen=True)
class Swinging:
    """One angular frequency for every point; it asks for a dose of .25 of what a linear extrapolation gives."""

    frames: int = FRAMES

    def parameters(self, values):
        return (SimpleNamespace(step=0.1),) * len(values)

    def positions(self, values):
        swing = np.sin((2.0 + values[0]) * np.arange(self.frames))
        return np.broadcast_to(swing[:, None, None], (self.frames, POINTS, 3))


def test_a_fit_begins_at_the_share_of_the_screened_dose_that_fits_best():
    seen = Swinging().positions([0.25])
    base, errors = case(np.zeros(FRAMES * POINTS * 3), 0.0)
    base.positions = np.zeros((FRAMES, POINTS, 3))
    base.residual = lambda positions: (seen - positions).ravel()
    starts = [np.array([share]) for share in (1.0, 0.5, 0.25)]
    assert _best_start(base, errors, Swinging(), starts) == pytest.approx([0.25])
    assert _best_start(base, errors, Swinging(), starts[:1]) == pytest.approx([1.0])


def struck_case(left):
    """Noise before the first contact in frame 8, then `left` times the numerical error that is expected."""
    rng, (base, _) = np.random.default_rng(0), case(None, 0.0)
    frames = base.observations.frames
    struck = frames >= 8
    numerical = np.where(struck, 400.0, 0.0)
    residual = rng.normal(size=len(frames)) * np.where(struck, left * 20.0, 1.0)
    base.residual = lambda positions: residual
    base.modes = BodyModes(frames, np.full(len(frames), 2) + 3 * struck, (6.0, 6.0, 12.0) * 2)
    errors = ErrorModel(1 + 20 * numerical, np.zeros((0, len(frames))), 1 + numerical)
    return base, errors


def test_what_is_left_after_an_impact_is_not_averaged_with_noise_before_it():
    base, errors = struck_case(3.0)
    assert mean_square(base, errors, np.zeros(0), base.split.fitted) == pytest.approx(9.0, rel=0.1)


def test_noise_before_an_impact_lends_no_weight_to_what_comes_after():
    """With one mean over all, of which two thirds are noise, an effect in the others gained ten times as much."""
    worse, better = (likelihood(*struck_case(left)) for left in (3.0, 1.0))
    independent = 3.0 * 4 + 3.0 * 3  # three numbers a frame, four fitted ones and three that choose
    assert (better - worse).sum() == pytest.approx(0.5 * independent * np.log(10 / 2), rel=0.2)


def test_a_dose_is_priced_by_the_residuals_that_tell_it():
    """What only an impact shows is not told by hundreds of markers before it, and need not outweigh their number."""
    base, errors = struck_case(3.0)
    residual, struck = base.residual(None), base.observations.frames >= 8
    base.positions = np.zeros(0)
    base.residual = lambda positions: residual if positions is base.positions else residual + 5.0 * struck
    assert list(moved_kinds(base, errors, np.ones(1))) == [False] * 5 + [True]
    assert moved_kinds(base, errors, base.positions).all()  # the base model itself
    effects = (SimpleNamespace(doses=(SimpleNamespace(implausibility=lambda value: 0.0),), source="material"),)
    few, many = (evidence_of(np.zeros(6), n * np.eye(6)[5], effects, np.ones(1)) for n in (21.0, 981.0))
    assert few - many == pytest.approx(0.5 * np.log(981 / 21))


@pytest.mark.wrong_types
def test_what_acts_on_impact_is_not_priced_by_the_residuals_of_the_flight():
    dose = SimpleNamespace(implausibility=lambda value: 0.0)
    spin, friction = (SimpleNamespace(doses=(dose,) * n, source=s) for n, s in ((3, "initial state"), (1, "contact")))
    information, struck = np.array([500.0, 20.0]), np.array([False, True])

    def evidence(*effects):
        values = np.ones(sum(len(e.doses) for e in effects))
        return evidence_of(np.zeros(2), information, effects, values, struck=struck)

    assert evidence(friction) == pytest.approx(-0.5 * np.log(20))
    assert evidence(spin) == pytest.approx(-1.5 * np.log(520))
    assert evidence(spin, friction) == evidence(friction, spin) == pytest.approx(-1.5 * np.log(520) - np.log(20))


def test_where_a_load_hangs_costs_no_more_than_the_recording_tells_of_it():
    """Of a light load nothing tells it, and it cost as much as the load's mass: a wrong frame rate led for that."""
    load = next(e for e in DEFAULT_EFFECTS if e.name == "attached_mass" and len(e.doses) == 2)
    information, values = np.array([100.0]), np.array([5.0, 0.03, 0.0])

    def price(*deviations):
        told = np.array([0.01, *deviations]) if deviations else None
        odd = sum(d.implausibility(v) for d, v in zip(load.doses, values[1:], strict=True))
        return -evidence_of(np.zeros(1), information, (load,), values, deviations=told) - odd

    one = 0.5 * np.log(100)
    assert price() == price(1e-3, 1e-4) == pytest.approx(2 * one)  # told well
    wide = load.doses[1].plausible
    assert price(1e-3, wide / 2) == pytest.approx(one + np.log(2))
    assert price(1e-3, 3 * wide) == price(1e-3, wide) == pytest.approx(one)
    assert price(5.0, wide) == pytest.approx(one)  # the mass itself is not cheaper for being told badly


def left(squares, information, **changed):
    """What kinds of residuals that are so large leave to explain."""
    seen, later = (-0.5 * information * np.log(np.array(part) + 1.0) for part in (squares, (9.0, 9.0)))
    fields = {"likelihood": seen + later, "later": later, "information": information, "divisor": np.ones(2)} | changed
    blank = dict.fromkeys(("model", "values", "errors", "positions", "motion", "tangents"))
    return Hypothesis((), **blank, fitted=0.0, selecting=0.0, evidence=0.0, **fields).left_to_explain


def test_what_a_flight_leaves_is_left_to_explain_however_well_the_rest_is_followed():
    """In the mean over both kinds, of which the second has ten times as many, 1.2 of what is expected is left."""
    information = np.array([20.0, 200.0])
    assert left((4.0, 0.9), information) == pytest.approx(10 * np.log(5 / 2))
    assert left((0.9, 0.9), information) == 0.0
    assert left((1.4, 1.2), 100 * information) == 0.0  # much information on what lies within the errors
    assert left((4.0, 0.9), information, divisor=np.array([2.0, 1.0])) == pytest.approx(5 * np.log(5 / 2))


def test_where_an_inclusion_lies_is_no_dose_that_a_body_could_not_bear():
    """Of a body with a stiff end and a slow clock, the fit of both was left out: its inclusion lay at the face."""
    effect = next(e for e in DEFAULT_EFFECTS if e.label == "heterogeneity (inclusion, +x+y+z)")
    fit = SimpleNamespace(effects=(effect,), doses=lambda _: (np.array([0.5, 1.0, 0.2, 0.2]), None))
    assert doses_at_bounds(fit) == []
    fit.doses = lambda _: (np.array([3.0, 0.5, 0.2, 0.2]), None)
    assert len(doses_at_bounds(fit)) == 1


def test_a_part_may_be_a_hundred_times_as_stiff_as_the_rest():
    """Of a bar with such a part (2301/029) the right fit lay at a bound of 30 times, and counted for nothing."""
    inclusions = [e for e in DEFAULT_EFFECTS if e.variant.startswith("inclusion")]
    fits = [SimpleNamespace(effects=(e,), doses=lambda _: (np.array([2.0, 0.5, 0.2, 0.2]), None)) for e in inclusions]
    assert fits and not any(doses_at_bounds(fit) for fit in fits)
