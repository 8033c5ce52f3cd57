"""The verdict from the evidence of made-up hypotheses."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, GapOptions, Hypothesis
from physconvex.gap.judgement import verdict as rules
from physconvex.gap.judgement.caveats import caveats_of
from physconvex.gap.judgement.naming import favoured, probabilities
from physconvex.gap.judgement.residual_measures import Measured
from physconvex.gap.search.hypothesis import within_bounds

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits

OPTIONS = GapOptions()


def effect(name):
    return next(e for e in DEFAULT_EFFECTS if e.name == name)


def hypothesis(evidence, *names, log10_modulus=5.0, dose=0.1, slight=(), later=0.0):
    effects = tuple(effect(n) for n in names)
    values = [np.full(len(e.doses), 0.0 if e.name in slight else dose) for e in effects]
    found = SimpleNamespace(
        effects=effects,
        names=tuple(e.name for e in effects),
        label=" + ".join(e.label for e in effects) or "base model",
        evidence=evidence,
        foretells_more_than=lambda other: later >= other.later,
        later=later,
        fitted=9.0 if not names else 1.0,
        values=np.array([log10_modulus]),
        model=SimpleNamespace(
            base=("log10_youngs_modulus",), mesh=None, situation=SimpleNamespace(clamped=False, in_soft_floor=False)
        ),
        doses=lambda one: (values[effects.index(one)], 0.1 * values[effects.index(one)]),
    )
    found.is_slight = lambda *some: Hypothesis.is_slight(found, *some)
    return found


def decide(hypotheses, screening, before, after, remaining, options, **more):
    return rules.decide(hypotheses, screening, Measured(before, after, 1.0 - remaining, **more), options)


def screening(p_value=1e-6, alike=0.1):
    return screening_with("damping", "wind", "friction", "time_step", p_value=p_value, alike=alike)


def screening_with(*names, p_value=1e-6, alike=0.1):
    ranked = tuple(
        SimpleNamespace(
            effect=effect(n),
            score=SimpleNamespace(p_value=p_value),
            power=1.0,
            errors=np.full(len(effect(n).doses), 0.01),
        )
        for n in names
    )
    return SimpleNamespace(ranked=ranked, one_per_name=ranked, similarity=lambda a, b: alike)


def test_probabilities_add_to_one_and_keep_the_best_variant():
    found = probabilities([hypothesis(3.0, "damping"), hypothesis(1.0, "damping"), hypothesis(0.0)])
    assert sum(found.values()) == pytest.approx(1) and len(found) == 2
    assert found["damping"] == pytest.approx(np.exp(3) / (1 + np.exp(3)))


def test_a_dose_that_is_of_no_interest_is_not_named_beside_another():
    both = hypothesis(20.0, "damping", "wind", slight=("wind",))
    verdict = decide([both, hypothesis(10.0, "damping"), hypothesis(0.0)], screening(), 30.0, 1.0, 0.05, OPTIONS)
    assert verdict.name == "effect" and [e.name for e in verdict.effects] == ["damping"]
    assert "wind" not in verdict.sentence


def test_a_clear_effect_is_named_with_its_dose():
    verdict = decide([hypothesis(20.0, "damping"), hypothesis(0.0)], screening(), 30.0, 1.0, 0.05, OPTIONS)
    assert verdict.name == "effect" and "damping" in verdict.sentence
    dose = verdict.effects[0].doses[0]
    assert dose.lower < dose.value < dose.upper and dose.unit == "s"
    assert verdict.effects[0].probability == pytest.approx(0.94, abs=1e-3)  # what calls have turned out to be right


def test_no_fit_tells_a_dose_better_than_two_programs_mean_it():
    sure = hypothesis(20.0, "gravity_tilt")
    sure.doses = lambda one: (np.array([3.0, 4.0]), np.full(2, 1e-6))
    verdict = decide([sure, hypothesis(0.0)], screening_with("gravity_tilt"), 30.0, 1.0, 0.05, OPTIONS)
    for dose in verdict.effects[0].doses:  # by a fiftieth of the tilt, about either axis
        assert dose.upper - dose.value == pytest.approx(1.645 * 0.02 * 5.0, rel=1e-3)
    sure.model.situation.clamped = True  # a body that does nothing but deform
    verdict = decide([sure, hypothesis(0.0)], screening_with("gravity_tilt"), 30.0, 1.0, 0.05, OPTIONS)
    assert all(d.upper - d.value == pytest.approx(1.645 * 0.05 * 5.0, rel=1e-3) for d in verdict.effects[0].doses)
    sure = hypothesis(20.0, "plasticity")
    sure.doses = lambda one: (np.array([4.0]), np.full(1, 1e-6))
    verdict = decide([sure, hypothesis(0.0)], screening_with("plasticity"), 30.0, 1.0, 0.05, OPTIONS)
    dose = verdict.effects[0].doses[0]  # log10 of a yield stress
    assert np.log(10) * (dose.upper - dose.value) == pytest.approx(1.645 * 0.05, rel=1e-3)


def test_nothing_is_called_where_the_clock_left_no_time_for_what_the_recording_asks_for():
    fits = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    verdict = decide(fits, screening(), 30.0, 1.0, 0.05, OPTIONS, hurried=True)
    assert verdict.name == "inconclusive" and "clock" in verdict.sentence
    assert [e.name for e in verdict.effects] == ["damping"]


def test_a_flight_that_no_effect_closes_is_unknown_whatever_the_impact_hides():
    slight = hypothesis(1.0, "wind", slight=("wind",))
    fits = [slight, hypothesis(0.0)]
    hidden = {"floor": 0.3, "struck": True}
    assert decide(fits, screening(), 30.0, 30.0, 1.0, OPTIONS, **hidden).name == "inconclusive"
    verdict = decide(fits, screening(), 30.0, 30.0, 1.0, OPTIONS, flight_left=9.0, **hidden)
    assert verdict.name == "unknown" and "at least 9 times" in verdict.sentence
    assert decide(fits, screening(), 1.0, 1.0, 1.0, OPTIONS, flight_left=9.0).name == "unknown"  # no gap elsewhere
    hurried = decide(fits, screening(), 30.0, 30.0, 1.0, OPTIONS, flight_left=9.0, hurried=True, **hidden)
    assert hurried.name == "inconclusive"  # not all were tried
    called = decide(
        [hypothesis(20.0, "damping"), hypothesis(0.0)], screening(), 30.0, 1.0, 0.05, OPTIONS, flight_left=9.0
    )
    assert called.name == "effect"


def test_other_fits_that_have_the_effect_widen_its_interval():
    def width(*others):
        found = decide([hypothesis(20.0, "damping"), *others, hypothesis(0.0)], screening(), 30.0, 1.0, 0.05, OPTIONS)
        dose = found.effects[0].doses[0]
        assert dose.value == pytest.approx(0.1)
        return dose.upper - dose.value

    alone = width()
    assert width(hypothesis(20.0, "damping", "wind", dose=0.13)) > 1.5 * alone
    assert width(hypothesis(0.1, "damping", "wind", dose=0.13)) == pytest.approx(alone, rel=1e-3)
    assert width(hypothesis(20.0, "friction", dose=0.3)) == pytest.approx(alone)


@pytest.mark.parametrize(
    ("gain", "remaining", "placebo", "name"),
    [
        (3.2, 0.2, 0.0, "effect"),
        (3.2, 0.4, 0.0, "inconclusive"),  # of such a gain two thirds must go on held-out frames
        (2.0, 0.2, 0.0, "inconclusive"),
        (2.0, 0.05, 0.0, "effect"),
        (3.2, 0.2, 0.2, "inconclusive"),
        (4.5, 0.4, 0.0, "effect"),
        (1.2, 0.01, 0.0, "inconclusive"),
    ],
)
def test_what_is_foretold_makes_up_for_a_smaller_gain(gain, remaining, placebo, name):
    hypotheses = [hypothesis(gain, "damping"), hypothesis(0.0)]
    verdict = decide(hypotheses, screening(), 30.0, 9.0, remaining, OPTIONS, placebo=placebo)
    assert verdict.name == name


def test_no_gap_is_none():
    verdict = decide([hypothesis(0.5, "damping"), hypothesis(0.0)], screening(0.3), 1.0, 1.0, 0.9, OPTIONS)
    assert verdict.name == "none" and not verdict.effects


def test_a_blind_model_does_not_say_none():
    hypotheses = [hypothesis(0.5, "damping"), hypothesis(0.0)]
    verdict = decide(hypotheses, screening(0.3), 1.0, 1.0, 0.9, OPTIONS, floor=0.3)
    assert verdict.name == "inconclusive" and "numerical error" in verdict.sentence


def test_significance_counts_the_whole_dictionary():
    hypotheses = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    assert decide(hypotheses, screening(0.03), 30.0, 1.0, 0.0, OPTIONS).name == "none"


def test_a_gap_that_nothing_explains_is_unknown():
    verdict = decide([hypothesis(20.0, "damping"), hypothesis(0.0)], screening(), 30.0, 25.0, 0.8, OPTIONS)
    assert verdict.name == "unknown" and "none of the known effects" in verdict.sentence


@pytest.mark.parametrize(("above_error", "name"), [(0.7, "effect"), (0.3, "unknown")])
def test_what_is_within_the_models_error_is_not_left_unexplained(above_error, name):
    hypotheses = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    verdict = decide(hypotheses, screening(), 5.0, 2.3, 0.6, OPTIONS, placebo=0.0, above_error=above_error)
    assert verdict.name == name


def test_an_effect_no_better_than_a_placebo_is_not_named():
    hypotheses = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    verdict = decide(hypotheses, screening(), 30.0, 1.0, 0.05, OPTIONS, placebo=0.86)
    assert verdict.name == "inconclusive" and "86%" in verdict.sentence
    assert decide(hypotheses, screening(), 30.0, 1.0, 0.05, OPTIONS, placebo=0.1).name == "effect"


def test_an_effect_that_foretells_nothing_is_not_named():
    hypotheses = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    for placebo in (-0.5, float("nan")):  # a placebo that does worse is no reason to believe it
        verdict = decide(hypotheses, screening(), 30.0, 1.5, 1.1, OPTIONS, placebo=placebo)
        assert verdict.name == "inconclusive" and "removes nothing of the gap" in verdict.sentence


@pytest.mark.parametrize(
    ("reported", "after", "name"), [(-0.03, 9.0, "inconclusive"), (-0.03, 1.2, "effect"), (0.1, 9.0, "effect")]
)
def test_an_effect_must_foretell_frames_that_did_not_choose_it(reported, after, name):
    """Fibres followed a tether into the frames that choose, .64 of the gap there, and removed nothing of the others."""
    fits = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    verdict = decide(fits, screening(), 30.0, after, 0.36, OPTIONS, placebo=0.07, reported=reported)
    assert verdict.name == name


@pytest.mark.parametrize(("seen", "remaining", "name"), [(5.4, 1.0, "unknown"), (3.0, 1.0, "none"), (5.4, 0.3, "none")])
def test_a_wide_gap_in_held_out_frames_is_not_argued_away(seen, remaining, name):
    """An impact near the end of the fitted frames: 25 mm where 5 are expected, and no effect that fits."""
    fits = [hypothesis(0.5, "damping", dose=0.6), hypothesis(0.0)]
    verdict = decide(fits, screening(p_value=0.5), 3.0, 3.0, remaining, OPTIONS, placebo=0.0, seen=seen, struck=True)
    assert verdict.name == name


def test_a_further_effect_that_gains_little_is_not_named():
    alone, plain = hypothesis(20.0, "damping"), hypothesis(0.0)
    for gain, names in ((0.3, ["damping"]), (1.4, ["damping"]), (2.0, ["damping", "wind"])):
        fits = [hypothesis(20.0 + gain, "damping", "wind", dose=0.6), alone, plain]
        assert list((favoured(fits) or plain).names) == names
        verdict = decide(fits, screening(), 30.0, 1.0, 0.05, OPTIONS, placebo=0.0)
        assert verdict.name == "effect" and [e.name for e in verdict.effects] == names
    other = hypothesis(19.9, "friction")  # no part of the best fit
    assert favoured([hypothesis(20.0, "damping", "wind"), other, plain]).names == ("damping", "wind")
    assert favoured([hypothesis(20.0, "damping"), plain]).names == ("damping",) and favoured([plain]) is None


@pytest.mark.parametrize(("soft", "further", "gain", "both"), [
    (False, "damping", 6.0, True), (True, "damping", 6.0, False), (True, "damping", 60.0, False),
    (True, "plasticity", 11.3, False), (True, "wind", 6.0, False), (True, "wind", 12.0, True),
])  # fmt: skip
def test_a_further_effect_must_gain_more_beside_a_floor_that_gives_way(soft, further, gain, both):
    """Damping, and flow, beside the friction of a cube that MuJoCo threw on a soft floor, where there was none."""
    fits = [hypothesis(20.0 + gain, "friction", further), hypothesis(20.0, "friction"), hypothesis(0.0)]
    for fit in fits:
        fit.model.situation.in_soft_floor = soft
    assert favoured(fits).names == (("friction", further) if both else ("friction",))
    told = decide(fits, screening_with("friction", further), 30.0, 1.0, 0.05, OPTIONS)
    assert (f"perhaps also by {further} (or the floor)" in told.sentence) == (not both)


@pytest.mark.parametrize(("later", "names"), [(-0.5, ["damping"]), (0.5, ["damping", "wind"])])
def test_a_further_effect_that_foretells_nothing_is_not_named(later, names):
    """Twenty in the frames that were fitted, and less than nothing in those that were not."""
    both = hypothesis(40.0, "damping", "wind", dose=0.6, later=later)
    verdict = decide([both, hypothesis(20.0, "damping"), hypothesis(0.0)], screening(), 30.0, 1.0, 0.05, OPTIONS)
    assert verdict.name == "effect" and [e.name for e in verdict.effects if e.probability > 0.9] == names
    assert ("wind" in verdict.sentence) == ("wind" in names)


def test_a_model_that_does_not_follow_the_recording_names_nothing():
    hypotheses = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    verdict = decide(hypotheses, screening(), 900.0, 300.0, 0.3, OPTIONS, astray=7.0)
    assert verdict.name == "unknown" and not verdict.effects and "boundary" in verdict.sentence
    assert decide(hypotheses, screening(), 30.0, 1.0, 0.05, OPTIONS, astray=0.1).name == "effect"


def test_a_dose_at_its_bound_is_told():
    for dose, told in ((-30.0, True), (12.0, False), (0.0, False)):
        verdict = decide([hypothesis(20.0, "wind", dose=dose), hypothesis(0.0)], screening(), 30.0, 1.0, 0.05, OPTIONS)
        assert any("bound of what is physical: wind" in caveat for caveat in verdict.caveats) == told


def test_fits_at_a_bound_give_way_to_others():
    blown, damped, plain = hypothesis(20.0, "wind", dose=-30.0), hypothesis(9.0, "damping"), hypothesis(0.0)
    assert within_bounds([blown, damped, plain]) == [damped, plain]
    assert within_bounds([blown, plain]) == [blown, plain]


def test_held_out_frames_make_up_for_weak_evidence():
    """Where little of the residual is independent, what an effect foretells and a placebo does not still counts."""
    fits = [hypothesis(2.5, "damping"), hypothesis(0.0)]
    assert decide(fits, screening(), 30.0, 1.0, 0.04, OPTIONS, placebo=0.0).name == "effect"
    assert decide(fits, screening(), 30.0, 1.0, 0.04, OPTIONS, placebo=0.3).name == "inconclusive"
    assert decide(fits, screening(), 30.0, 1.0, 0.3, OPTIONS, placebo=0.0).name == "inconclusive"


def test_a_weak_case_is_inconclusive():
    verdict = decide([hypothesis(2.5, "damping"), hypothesis(0.0)], screening(), 30.0, 1.0, 0.1, OPTIONS)
    assert verdict.name == "inconclusive" and verdict.none_probability > 0.05


def test_rivals_and_look_alikes_are_told():
    rival = decide(
        [hypothesis(20.0, "damping"), hypothesis(19.5, "wind"), hypothesis(0.0)], screening(), 30.0, 1.0, 0.1, OPTIONS
    )
    assert rival.effects[0].confused_with == ("wind",) and [e.name for e in rival.effects] == ["damping", "wind"]
    alike = decide([hypothesis(20.0, "damping"), hypothesis(0.0)], screening(alike=0.99), 30.0, 1.0, 0.1, OPTIONS)
    assert set(alike.effects[0].confused_with) == {"wind", "friction", "time_step"}


def test_what_is_declared_to_look_alike_is_told_where_it_nearly_does():
    """Of five held bars with a small load, called a wrong frame rate, the report named none that looks alike."""
    fits, seen = [hypothesis(20.0, "time_scale"), hypothesis(0.0)], ("time_scale", "attached_mass", "wind")
    for similarity, told in ((0.9, ("attached_mass",)), (0.8, ())):
        verdict = decide(fits, screening_with(*seen, alike=similarity), 30.0, 1.0, 0.1, OPTIONS)
        assert verdict.effects[0].confused_with == told


def test_absorbed_modulus_is_a_caveat():
    moved = decide(
        [hypothesis(20.0, "damping", log10_modulus=5.2), hypothesis(0.0)], screening(), 30.0, 1.0, 0.1, OPTIONS
    )
    assert any("absorbed" in c for c in moved.caveats)
    still = decide([hypothesis(20.0, "damping"), hypothesis(0.0)], screening(), 30.0, 1.0, 0.1, OPTIONS)
    assert not any("absorbed" in c for c in still.caveats)


def test_numerical_error_is_no_cause():
    found = decide([hypothesis(30.0, "time_step"), hypothesis(0.0)], screening(), 9.0, 1.0, 0.1, OPTIONS)
    assert found.name == "none" and [e.name for e in found.effects] == ["time_step"]
    assert "numerical error" in found.sentence


def test_numerical_error_that_hides_everything_is_no_answer():
    hypotheses = [hypothesis(30.0, "time_step"), hypothesis(0.0)]
    found = decide(hypotheses, screening(), 9.0, 1.0, 0.1, OPTIONS, floor=0.3)
    assert found.name == "inconclusive" and "hide whatever gap there is" in found.sentence


def test_nothing_found_tells_what_would_have_been():
    found = decide([hypothesis(0.0), hypothesis(-3.0, "damping")], screening(0.5), 1.0, 1.0, 0.9, OPTIONS)
    assert found.name == "none" and any("damping 0.03 s" in c and "friction 0.03" in c for c in found.caveats)


def test_the_weightier_of_two_effects_comes_first():
    fits = [hypothesis(40.0, "wind", "damping", dose=0.6), hypothesis(30.0, "damping"), hypothesis(5.0, "wind")]
    fits.append(hypothesis(0.0))
    found = decide(fits, screening(), 30.0, 1.0, 0.1, OPTIONS)
    assert [e.name for e in found.effects[:2]] == ["damping", "wind"]
    assert found.effects[0].probability == pytest.approx(0.94, abs=1e-6)


def test_effects_that_are_not_likely_are_not_named():
    found = [hypothesis(20.1, "damping", "friction"), hypothesis(20.0, "damping", "wind"), hypothesis(0.0)]
    verdict = decide(found, screening(), 30.0, 1.0, 0.05, OPTIONS)
    assert verdict.name == "effect" and "caused by damping + friction (" in verdict.sentence  # one of two equals
    found.insert(1, hypothesis(20.0, "damping"))
    verdict = decide(found, screening(), 30.0, 1.0, 0.05, OPTIONS)
    assert "caused by damping (" in verdict.sentence and "perhaps also by friction (33%)" in verdict.sentence


def test_something_else_takes_probability():
    found = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    verdict = decide(found, screening(), 30.0, 1.0, 0.9, OPTIONS, other=22.0)
    assert verdict.name == "inconclusive" and "something else 79%" in verdict.sentence  # 0.88 of the 0.9 that is left
    assert decide(found, screening(), 30.0, 1.0, 0.9, OPTIONS, other=16.0).name == "effect"
    verdict = decide(found, screening(), 30.0, 1.0, 0.4, OPTIONS, other=22.0)
    assert verdict.name == "effect" and verdict.effects[0].probability == pytest.approx(
        0.94 * (1 - 0.88 * 0.4), abs=0.01
    )


def test_a_clear_gap_that_no_effect_explains_better_is_not_none():
    found = [hypothesis(0.9, "damping"), hypothesis(0.0)]
    assert decide(found, screening(), 30.0, 9.0, 0.05, OPTIONS).name == "inconclusive"
    assert decide(found, screening(), 2.0, 1.0, 0.05, OPTIONS).name == "none"


@pytest.mark.parametrize(
    ("after", "floor", "name"), [(25.0, 0.0, "inconclusive"), (1.0, 0.0, "none"), (25.0, 0.3, "inconclusive")]
)
def test_a_slight_dose_that_leaves_a_clear_gap_is_not_none(after, floor, name):
    hypotheses = [hypothesis(20.0, "damping", dose=1e-9), hypothesis(0.0)]
    verdict = decide(hypotheses, screening(), 30.0, after, 0.9, OPTIONS, floor=floor)
    assert verdict.name == name and not verdict.effects
    assert ("leaves it" in verdict.sentence) == (name == "inconclusive" and not floor)


def test_what_was_taken_from_the_recording_is_told():
    plain = hypothesis(0.0)
    assert not any("floor" in c or "elements" in c for c in caveats_of(plain, plain, 1.0))
    soft = hypothesis(0.0)
    soft.model.base = ("log10_youngs_modulus", "log10_contact_stiffness", "contact_damping")
    soft.values = np.array([4.7, 6.0, 9e-3])
    soft.model.mesh = SimpleNamespace(order=1, mass_shares=None)
    told = " ".join(caveats_of(soft, soft, 1.0))
    assert "1e+06 Pa/m" in told and "9 ms" in told and "restitution" in told and "linear elements" in told


@pytest.mark.parametrize(
    ("remaining", "placebo", "name"), [(0.04, 0.0, "effect"), (0.3, 0.0, "none"), (0.04, 0.5, "none")]
)
def test_a_gap_that_opens_after_the_fitted_frames_counts_if_the_effect_foretells_it(remaining, placebo, name):
    """Damping of a body that is still in contact where the fitted frames end: they fit, and screening sees nothing."""
    quiet = hypothesis(0.0)
    quiet.fitted = 1.0
    hypotheses = [hypothesis(2.5, "damping"), quiet]
    assert decide(hypotheses, screening(p_value=0.2), 30.0, 1.0, remaining, OPTIONS, placebo=placebo).name == name


@pytest.mark.parametrize(("behind", "name"), [(-1.3, "inconclusive"), (1.0, "effect")])
def test_an_effect_that_is_hardly_likelier_than_something_else_is_not_called(behind, name):
    """A cube of another program without an effect, of which two effects together explained a third, 51 to 49 %."""
    hypotheses = [hypothesis(20.0, "damping", "wind"), hypothesis(0.0)]
    verdict = decide(
        hypotheses, screening(), 30.0, 3.0, 0.6, OPTIONS, placebo=0.0, above_error=0.6, other=20.0 - behind
    )
    assert verdict.name == name


@pytest.mark.parametrize(
    ("gain", "remaining", "name"), [(29.0, 0.2, "effect"), (70.0, 0.7, "none"), (4.0, 0.3, "none")]
)
def test_an_effect_within_the_error_of_the_fitted_frames_counts_if_much_asks_for_it(gain, remaining, name):
    quiet = hypothesis(0.0)
    quiet.fitted = 1.2
    hypotheses = [hypothesis(gain, "damping"), quiet]
    assert decide(hypotheses, screening(), 2.0, 1.0, remaining, OPTIONS, placebo=0.0).name == name


@pytest.mark.parametrize(
    ("other", "remaining", "name"), [(-50.0, 0.01, "effect"), (-50.0, 0.2, "inconclusive"), (19.5, 0.01, "effect")]
)
def test_an_effect_beyond_doubt_that_leaves_far_less_than_a_placebo_is_named(other, remaining, name):
    """Refits of E and ν beside a wrong effect take half of a held body's gap; the right one takes all of it."""
    hypotheses = [hypothesis(20.0, "damping"), hypothesis(0.0)]
    assert decide(hypotheses, screening(), 30.0, 1.0, remaining, OPTIONS, placebo=0.5, other=other).name == name


@pytest.mark.parametrize(("remaining", "name"), [(0.05, "effect"), (0.13, "inconclusive")])
def test_so_is_one_that_takes_nearly_all_although_another_might_too(remaining, name):
    hypotheses = [hypothesis(20.0, "damping"), hypothesis(19.0, "friction"), hypothesis(0.0)]
    verdict = decide(hypotheses, screening(), 30.0, 1.0, remaining, OPTIONS, placebo=0.5)
    assert verdict.name == name and 0.66 < verdict.effects[0].probability < 0.7


@pytest.mark.parametrize(("remaining", "placebo", "name"), [(0.12, 0.15, "effect"), (0.12, 0.6, "none")])
def test_so_is_one_within_the_error_that_leaves_a_quarter_of_what_a_placebo_does(remaining, placebo, name):
    """A stiffening drop: 16 of evidence and seven eighths of the gap, of which a wrong effect took a seventh."""
    quiet = hypothesis(0.0)
    quiet.fitted = 1.1
    fits = [hypothesis(16.0, "damping"), quiet]
    assert decide(fits, screening(), 2.0, 0.5, remaining, OPTIONS, placebo=placebo, struck=True).name == name


@pytest.mark.parametrize(
    ("remaining", "placebo", "struck", "name"),
    [(0.03, 0.13, True, "effect"), (0.03, 0.75, True, "none"), (0.03, 0.13, False, "none")],
)
def test_so_is_one_of_a_struck_body_that_leaves_a_tenth_of_it(remaining, placebo, struck, name):
    """Fibres of a dropped body (2201/034): 24 mm of gap on frames that chose nothing come down to 4, the floor is 6."""
    quiet = hypothesis(0.0)
    quiet.fitted = 1.1
    fits = [hypothesis(2.1, "damping"), quiet]
    assert decide(fits, screening(), 2.0, 0.5, remaining, OPTIONS, placebo=placebo, struck=struck).name == name


def test_numerical_error_that_leaves_the_gap_is_no_answer():
    numerical = [hypothesis(20.0, "time_step"), hypothesis(0.0)]
    assert decide(numerical, screening(), 30.0, 1.0, 0.05, OPTIONS).name == "none"
    assert decide(numerical, screening(), 30.0, 6.0, 0.5, OPTIONS).name == "inconclusive"


def test_a_gap_that_opens_late_and_that_nothing_foretells_is_not_called_none():
    quiet = hypothesis(0.0)
    quiet.fitted = 1.0
    verdict = decide([hypothesis(2.5, "damping"), quiet], screening(), 30.0, 12.0, 0.6, OPTIONS, placebo=0.0)
    assert verdict.name == "inconclusive" and "after the frames that were fitted" in verdict.sentence
    assert decide([hypothesis(2.5, "damping"), quiet], screening(), 3.0, 2.0, 0.6, OPTIONS, placebo=0.0).name == "none"


def test_what_parts_after_an_impact_alone_is_not_called_unknown():
    fits = [hypothesis(30.0, "damping"), hypothesis(0.0)]
    assert decide(fits, screening(), 30.0, 9.0, 0.8, OPTIONS, placebo=0.0).name == "unknown"
    assert decide(fits, screening(), 30.0, 9.0, 0.8, OPTIONS, placebo=0.0, struck=True).name == "inconclusive"
    fits[0].fitted = 3.0  # a gap in the frames that are fitted
    for forgiven, name in ((1.6, "inconclusive"), (4.0, "unknown")):  # of a rebound as a whole, or of more than that
        verdict = decide(fits, screening(), 30.0, 9.0, 0.8, OPTIONS, placebo=0.0, struck=True, forgiven=forgiven)
        assert verdict.name == name


def test_what_lies_within_the_error_of_a_body_that_is_not_struck_is_no_gap():
    fits = [hypothesis(13.0, "damping"), hypothesis(0.0)]
    for seen, struck, name in ((1.2, False, "none"), (5.0, False, "effect"), (1.2, True, "effect")):
        verdict = decide(fits, screening(), 1.2, 1.0, 0.1, OPTIONS, placebo=0.05, seen=seen, struck=struck)
        assert verdict.name == name


def test_much_evidence_or_an_open_gap_makes_up_for_a_screening_that_saw_nothing():
    for gain, seen, name in ((27.0, 1.2, "effect"), (6.6, 1.2, "none"), (6.6, 3.0, "effect")):
        fits = [hypothesis(gain, "damping"), hypothesis(0.0)]
        verdict = decide(fits, screening(0.5), 1.2, 1.0, 0.05, OPTIONS, placebo=0.0, struck=True, seen=seen)
        assert verdict.name == name


@pytest.mark.parametrize(
    ("flight", "names", "name"),
    [
        (30.0, ("wind", "damping"), "effect"),
        (3.0, ("wind", "damping"), "inconclusive"),
        (30.0, ("damping",), "inconclusive"),
    ],
)
def test_what_the_flight_shows_is_named_although_the_rebound_is_not_followed(flight, names, name):
    """A linear drag of .34 1/s in MuJoCo: a flight to within noise, and a rebound that is off by 15 mm all the same."""
    fits = [hypothesis(40.0, *names, dose=0.6), hypothesis(0.0)]
    verdict = decide(
        fits, screening(), 30.0, 20.0, 1.05, OPTIONS, placebo=0.0, above_error=-0.05, other=200.0, struck=True,
        flight=flight,
    )  # fmt: skip
    assert verdict.name == name
    if name == "effect":  # the damping is not what the flight shows
        assert [e.name for e in verdict.effects] == ["wind"] and verdict.effects[0].probability > 0.9
        assert "removes 0%" in verdict.caveats[0]


@pytest.mark.parametrize(("flight", "name"), [(30.0, "effect"), (3.0, "inconclusive")])
def test_what_the_flight_shows_is_named_although_the_rebound_tells_nothing(flight, name):
    """Behind a numerical error of a fifth of the motion all later frames lie within what is expected."""
    fits = [hypothesis(40.0, "wind", dose=0.6), hypothesis(0.0)]
    verdict = decide(fits, screening(), 1.1, 0.9, 1.05, OPTIONS, floor=0.2, placebo=0.0, struck=True, flight=flight)
    assert verdict.name == name
