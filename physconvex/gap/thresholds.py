# ruff: noqa: RUF009 `number` makes a field, it is no default that is shared
"""All decision thresholds of a diagnosis, with unit and reason.

They are frozen for the blind tests, and `report.json` lists them under `provenance.thresholds`. `GapOptions` holds the
settings of a caller. Purely computational numbers (tolerances of a solve, sizes of arrays and drawings) stand next to
their use, and those of an effect (bounds and sizes of its doses) in `physconvex.gap.effects`. The *expected square* of
a residual is the one that noise and numerical error predict.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import TypeVar

from pydantic import JsonValue
from pydantic_core import to_jsonable_python

T = TypeVar("T")
Pair = tuple[float, float]
Row = tuple[float, ...]


def number(value: T, unit: str, reason: str) -> T:
    """A field of a group: its value, its unit, and its reason."""
    made: T = field(default=value, metadata={"unit": unit, "reason": reason})
    return made


@dataclass(frozen=True)
class Numbers:
    """A group of numbers on one subject."""


@dataclass(frozen=True)
class _Clock(Numbers):
    """Wall-clock time: each stage ends at its fraction of `GapOptions.deadline`."""

    base_fit_ends: float = number(0.45, "of the deadline", "leaves half of the time for the search")
    search_ends: float = number(0.6, "of the deadline", "leaves a quarter of the time for full-order fits")
    decision_ends: float = number(0.85, "of the deadline", "leaves time for the placebo and the report")
    placebo_ends: float = number(0.95, "of the deadline", "leaves time for the report")


@dataclass(frozen=True)
class _RunCost(Numbers):
    """Cost of runs, computed from their size. Pairs are for the (full-order, reduced) model."""

    full_step: float = number(5e-6, "s per node", "Newton step of the base law, measured on 200 to 1500 nodes")
    reduced_step: float = number(4.5e-4, "s", "Newton step of the reduced model, including the work of a fit")
    damping: Pair = number((0.35, 1.6), "steps", "additional cost of a second stiffness matrix")
    other_law: Pair = number((4.0, 2.5), "steps", "additional cost of a law without compiled arithmetic")
    flow: Pair = number((0.3, 3.5), "steps", "additional cost of internal variables")
    stretches: Pair = number((4.5, 11.0), "steps", "additional cost of a polar decomposition at every sample")
    failed: int = number(4, "Newton steps per time step", "cost of a run that does not converge")
    placebo: float = number(30.0, "s", "cost of the fit of the placebo")
    held: float = number(1.5, "times the search cost", "runs of a held body take a third of their computed cost")
    longest_fit: float = number(0.15, "of the search cost", "a single fit must not use up the search")
    after_moving: float = number(0.5, "of the search cost", "additional cost for new numerical errors at a distant fit")
    leaving_out: float = number(0.2, "of the search cost", "reserved for fits without one of the best effects")


@dataclass(frozen=True)
class _BodyMesh(Numbers):
    """Regular mesh of a box-shaped body."""

    box: float = number(2e-3, "of volume and size", "largest difference of a box from its bounding box")
    slender: float = number(3.0, "longest edge over the others", "from here on one quadratic cell across is enough")
    slender_cell: float = number(0.4, "length over width", "shape of the cells of a slender box")
    several_across: float = number(4 / 3, "times the nodes", "additional nodes for several cells across a slender box")
    most_cells: int = number(16, "cells along an edge", "limits the search over cell counts")
    plane: float = number(5e-3, "of an edge", "a held part thinner than this is a plane")


@dataclass(frozen=True)
class _BaseFit(Numbers):
    """Fit of the base model, and its residuals."""

    most_frames: int = number(100, "frames", "simulation and recording diverge over longer times")
    fewest_frames: int = number(6, "frames", "fewer cannot be fitted, compared and reported separately")
    steps_per_wave: int = number(8, "time steps", "while an elastic wave crosses a free body")
    steps_per_wave_held: int = number(4, "time steps", "the same of a held body, which bends slowly without impact")
    most_steps: int = number(1000, "time steps of a simulation", "limits the time of a run")
    starts_held: int = number(3, "starts", "a vibration shifted by one period is another minimum")
    rounds: int = number(3, "rounds", "full-order run, then a search with the reduced model")
    still: float = number(0.02, "typical steps", "a smaller change of the parameters counts as none")
    usual_poisson_ratio: Pair = number((0.15, 0.47), "", "a fit outside this range suggests a missing effect")
    held_poisson_ratio: Pair = number((0.4, 0.1), "mean and deviation", "prior, since bending does not determine ν")
    searches_itself: float = number(1.5, "times the coarse nodes", "a mesh up to this size needs no cheaper model")
    flying: float = number(2e-3, "of the displacement", "error of a coarse model in flight")
    touched: float = number(0.01, "of the size", "error of a coarse model after the first contact")
    near: float = number(2e-3, "of the size", "distance from an obstacle that counts as contact")
    pushed: float = number(0.2, "of gravity", "acceleration that shows a contact between two frames")
    pixel_error: float = number(1.0, "pixels", "accumulated error of a tracked point")
    fewest_points: int = number(6, "points", "a frame with fewer gives little information")
    off_body: float = number(0.3, "of the size", "markers farther outside the bounding box are not on the body")
    noise_in_doubt: float = number(1.5, "times the stated noise", "scatter at rest that contradicts the stated noise")
    points_for_noise: int = number(8, "markers", "fewer leave no residual of an affine fit that shows the noise")
    starts_off: Pair = number((3.0, 4.0), "deviations", "of frame 0, in total and as a shift: more is no noise")
    lasting_points: float = number(0.25, "of the first frame's points", "with fewer remaining points a caveat is added")
    deep: float = number(0.02, "of the size", "penetration of markers that rejects a rigid floor")


@dataclass(frozen=True)
class _Setting(Numbers):
    """Unstated conditions of the recording: floor, elements, masses, strong damping."""

    rounds: int = number(2, "rounds", "derivatives of a joint fit are updated once")
    full_runs: int = number(6, "runs", "a short full-order fit")
    soft_depth: float = number(0.01, "of the size", "penetration of markers that shows a soft floor")
    soft_stiffness: float = number(1 / 3, "of the base model's floor", "a stiffer floor counts as rigid")
    better: float = number(0.7, "of the squares", "remaining misfit that accepts a soft floor or other elements")
    moduli: Row = number((0.0, 0.25, 0.45, 0.6, 0.75), "decades of E", "scanned, since a rigid floor lowers E")
    stiffnesses: Row = number((-0.7, -0.3, 0.1), "decades", "scanned around the one of the observed depth")
    dashpots: Row = number((0.0, 1.0, 3.0), "penetration times", "scanned with modulus and stiffness")
    poisson_ratio: Pair = number((0.3, 0.45), "", "ν at the start of a scan over floor or damping")
    fits: int = number(2, "fits", "from the best points of a scan")
    damping: float = number(0.15, "wave times", "damping that is scanned with every modulus")
    other_damping: Pair = number((0.05, 0.4), "wave times", "damping that is scanned around the best modulus")
    damped_better: float = number(0.6, "of the squares", "remaining misfit that accepts damping")
    own_work: int = number(600_000, "nodes times steps", "largest affordable simulation on the recording's elements")
    own_better: float = number(0.5, "of the squares", "the same for the elements of a held body")
    equal_masses: float = number(0.8, "of the squares", "remaining misfit that accepts equal masses of all nodes")
    own_moduli: Row = number((0.0, 0.04, -0.04, 0.1, -0.1), "decades of E", "around the one of equal frequency")
    surrogate_moduli: Row = number((-0.04, -0.02, 0.0, 0.02, 0.04), "decades of E", "the same, cheaper model")
    own_poisson_ratio: Pair = number((0.25, 0.45), "", "ν at the start of a fit on the recording's elements")
    hopeless: float = number(4.0, "times the squares", "misfit at the best E above which these elements are not fitted")


@dataclass(frozen=True)
class _NumericalError(Numbers):
    """Expected errors of residuals without any effect."""

    fine_work: int = number(600_000, "nodes times steps", "limits a full-order run that is made about twenty times")
    exact_work: int = number(1_000_000, "nodes times steps", "limits about ten runs with a quarter of these steps")
    order: float = number(1.75, "", "convergence order in the edge length; contact lowers it below two")
    finest: float = number(2.5, "times the finer mesh's nodes", "mesh that checks the finer mesh")
    exact_refinement: int = number(4, "steps for one", "time step of the most exact run")
    exact_left: float = number(0.2, "of the difference", "remaining time-step error of the most exact run")
    steps_left: float = number(0.5, "of the difference", "remaining error at half the time step")
    lasting: float = number(2.0, "frames", "correlation time of a numerical error")
    out_of_step: Row = number((0.01, 0.1, 0.5), "of displacement, strain, shape", "by which three simulators differ")
    sideways: float = number(0.2, "of the error along the normal", "nine effect-free bodies differ less across it")
    forgiven_rebound: float = number(3.0, "times the expected error", "largest between programs without effects")
    freedom: Row = number((6.0, 6.0, 12.0) * 2, "numbers per frame", "rigid, even strain, finer; then after contact")
    freedom_along: float = number(4.0, "numbers per frame", "the same after contact, along the normal and in rotation")
    freedom_across: float = number(2.0, "numbers per frame", "the same after contact, across the normal")
    freedom_undivided: float = number(12.0, "numbers per frame", "the same for undivided residuals: an affine motion")
    fewest_divided: int = number(18, "residuals of a frame", "fewer are not divided into kinds")
    scale_margin: float = number(4.0, "of squares", "keeps a chance fit of numerical error from being named an effect")
    least_scale: float = number(0.15, "", "smallest scale of the errors that is used")
    free_residuals: float = number(0.1, "of the independent ones", "least number that remains after fitting")
    scale_frames: int = number(2, "frames", "above noise, needed to estimate the scale")
    fit_anew: float = number(0.8, "", "scale of the errors below which the base fit is repeated")
    absorbed: float = number(1e-3, "of the size", "accuracy of a fit of one mesh to another")

    @property
    def fine_over_finest(self) -> float:
        """Error of the finer mesh over that of the finest one."""
        return float(self.finest ** (self.order / 3))


@dataclass(frozen=True)
class _Screening(Numbers):
    """Screening of effects."""

    same_as_placebo: float = number(0.7, "absolute cosine", "a placebo must differ more from every effect")
    in_sight: float = number(3.0, "standard errors", "a dose from here on is detectable")
    pairs_ranked: int = number(40, "pairs", "each is ranked by one regression")


@dataclass(frozen=True)
class _Search(Numbers):
    """Fits of effects with the reduced model, and their starting points."""

    closed: float = number(1.5, "of the expected square", "below it the base fit leaves no gap")
    wide: float = number(3.0, "of the expected square", "in fitted frames: search for another effect")
    late: float = number(5.0, "of the expected square", "in the frames that choose: a late impact shows there")
    left: float = number(6.0, "nats", "possible gain above which another effect is searched")
    worth: float = number(4.0, "nats", "gain for which the search continues")
    as_good: float = number(4.0, "nats", "loss that is accepted for a fit with one effect less")
    followed: float = number(1.5, "of the expected square", "below it the fit follows a kind of residuals")
    singles: int = number(7, "effects", "number fitted alone")
    stems: int = number(2, "fits", "number that the first further round extends")
    pairs: int = number(4, "fits", "number with two effects at once")
    added: int = number(3, "fits", "number in each further round")
    early: int = number(4, "fits", "number started from the first frames")
    elsewhere: int = number(4, "starts", "other positions of a local effect")
    polished: int = number(3, "fits", "number with updated derivatives")
    telling_points: int = number(4, "points", "fewer do not separate strain from rigid motion")
    rounds_held: int = number(6, "rounds", "of the fit of a held body")
    rounds_placed: int = number(3, "rounds", "of the fit of a local or directed effect in another body")
    still: float = number(0.98, "of the misfit", "above it another round is not worth its cost")
    settled: float = number(0.7, "of the uncertainty", "above it another round is not worth its cost")
    slight: float = number(0.5, "nats", "gain below which a free body gets no further round")
    sure: float = number(2.0, "", "uncertainty below which priors keep their weight")
    far: float = number(5.0, "typical steps", "largest change of other parameters beside a screened dose")
    moved: float = number(0.3, "typical steps", "from here on another start is tried")
    least_dose: float = number(0.2, "of the trial dose", "smallest start of a fit, so that the effect acts")
    most_dose: float = number(8.0, "trial doses", "largest start of a fit")
    early_told: float = number(0.015, "decades of E", "standard error at which the first frames determine E")
    early_longest: float = number(0.75, "of the fitted frames", "a longer window repeats the base fit")
    early_apart: float = number(0.04, "decades of E", "difference that makes a fit another start")
    far_modulus: float = number(0.5, "decades of E", "distance from the base fit that needs new numerical errors")
    flight_frames: int = number(5, "frames", "shortest flight that is fitted alone")
    flight_open: float = number(2.0, "of the expected square", "residual above which the flight is informative")
    flight_screened: tuple[int, int] = number((3, 6), "single effects, pairs", "number fitted to the flight")
    flight_fitted: tuple[int, int] = number((1, 2), "single effects, pairs", "number continued with all frames")
    flight_contact: int = number(4, "frames", "of the contact, which give a first estimate of E")
    flight_moduli: Row = number((-1.8, 1.9, 0.3), "decades of E", "start, end and step of a scan around the base fit")
    flight_moduli_full: Row = number((0.0, 0.1, 0.2, 0.3), "decades of E", "the same of the softer full-order model")
    flight_poisson_ratio: float = number(0.35, "", "ν of these scans")
    load_ratios: Row = number((0.0, 0.03, 0.06, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2), "of the body's mass", "scanned")
    load_slacks: Row = number((0.5, 1.0, 2.0, 3.0), "trial slacks", "scanned")
    load_step: float = number(0.05, "decades of E", "around the E of the recorded frequency")
    load_farthest: int = number(4, "such steps", "a large sag changes the frequency")
    load_moduli: Pair = number((3.0, 8.0), "log10 Pa", "bounds of that scan")


@dataclass(frozen=True)
class _Decision(Numbers):
    """Fits with the full-order model."""

    tied: float = number(1.0, "nats", "two variants of an effect with a smaller difference are equal")
    forms: int = number(3, "variants", "of one effect of a struck body; the reduced model errs by ten nats there")
    hopeless: float = number(25.0, "nats", "a fit that far behind the best one is dropped")
    sweeps: int = number(5, "sweeps", "over the full-order fits")
    slow: float = number(1.0, "nats", "gain below which there is no further sweep")
    rounds: int = number(2, "rounds", "of full-order run and search")
    still: float = number(0.02, "typical steps", "a smaller change of the parameters counts as none")
    diverged: float = number(1.5, "times the best mean square", "from here on such rounds end")


@dataclass(frozen=True)
class _Evidence(Numbers):
    """Evidence of residuals."""

    unseen: float = number(0.01, "of the expected square", "a smaller change of a kind gives no information")
    enough: float = number(1.0, "of the expected square", "a better fit gains nothing more")
    smooth: float = number(1 / 3, "of the frames", "least weight of a smooth residual")
    anything: int = number(8, "doses and effects", "cost of the hypothesis of an unknown effect")
    ringing_frames: int = number(8, "frames", "least number for the fit of a damped sine")
    ringing_explained: float = number(0.5, "of a signal", "explained by a damped sine: a vibration")
    main_shape: float = number(0.5, "of the squares", "of the deformation, so that its vibration counts")
    frequency_told: float = number(0.05, "relative error", "above it the recording does not determine the frequency")
    frequency_missed: float = number(0.05, "of the frequency", "error of a good model")
    damping_missed: float = number(0.5, "of the damping ratio", "error of a good model")
    least_damping_missed: float = number(0.02, "damping ratio", "smallest error of a good model")
    ringing_farthest: float = number(6.0, "standard deviations", "larger deviations count as this")


@dataclass(frozen=True)
class _Verdict(Numbers):
    """Rules that lead from fits to an answer."""

    weak: float = number(1.5, "nats", "a gain that leaves an effect undecided")
    clear: float = number(4.0, "nats", "a gain that names an effect")
    telling: float = number(10.0, "nats", "names an effect within the expected error, if half of the gap closes")
    soft_floor: float = number(10.0, "nats", "a smaller gain may come from the law of a soft contact")
    foretold: float = number(0.9, "of the held-out gap", "removes doubt, if a placebo removes less than a tenth")
    abundant: float = number(0.8, "times the required reduction", "accepted at twice the required gain")
    placebo: float = number(0.5, "of the effect's reduction", "a placebo with more speaks against the effect")
    placebo_left: float = number(0.25, "of the gap a placebo leaves", "largest remaining gap of a certain effect")
    certain: float = number(0.95, "probability", "from here on such a placebo is no objection")
    likely: float = number(0.5, "probability", "from here on an effect is named")
    listed: float = number(0.02, "probability", "from here on an effect is listed as possible")
    rival: float = number(0.1, "probability", "from here on a single effect counts as a confusion")
    doubt: float = number(0.4, "probability", "of no or an unknown effect, above which none is named")
    trusted: float = number(0.94, "of answers", "that are right in blind banks: 59 of 63, nearly all given with 1.00")
    floor: float = number(1.5, "of the expected square", "below it there is no gap")
    left_over: float = number(2.0, "of the expected square", "remaining square that is a gap, after effects")
    open: float = number(4.0, "of the expected square", "a gap, whether or not an effect explains it")
    seen: float = number(1.5, "rms over the expected error", "held out: a gap of a body without impact")
    wide: float = number(4.0, "rms over the expected error", "held out: a gap of any body")
    blind: float = number(0.1, "of size or motion", "numerical error above which `none` is not answered")
    astray: float = number(0.5, "of the motion", "larger deviations: the model does not describe the recording")
    flight_closed: float = number(2.0, "of the expected square", "up to it the flight is explained")
    alike: float = number(0.95, "cosine of signatures", "two effects that cannot be separated")
    alike_as_declared: float = number(0.85, "cosine of signatures", "the same of two effects of one confusion class")
    form: float = number(0.02, "of a dose", "difference between two programs with the same effect")
    form_deforming: float = number(0.05, "of a dose", "the same of material and contact effects, and of held bodies")
    absorbed: float = number(0.15, "relative change of E", "from here on a caveat names E as compensation")


@dataclass(frozen=True)
class _Localisation(Numbers):
    """Location of the gap."""

    shapes: int = number(3, "shapes", "of the deformation in the report")
    shape_share: float = number(0.02, "of the squares", "smaller shapes are omitted")


@dataclass(frozen=True)
class _Pictures(Numbers):
    """Effects of light and blur in a video."""

    clear: float = number(4.0, "nats", "gain that names an effect")
    placebo: float = number(0.5, "of the effect's reduction", "limit for a wrong direction of blur")
    doses: int = number(9, "doses", "at which the patches are rendered")
    fewest_patches: int = number(5, "patches", "in a frame, so that it counts")
    fewest_frames: int = number(6, "frames", "fewer give no answer")
    brightness_error: float = number(0.01, "log of the light", "error without any effect")
    smear_error: float = number(0.1, "log of the ratio", "error without any effect")
    dark: float = number(8.0, "grey value", "below it a picture is underexposed")
    bright: float = number(247.0, "grey value", "above it a picture is overexposed")
    faster: float = number(2.0, "times the first speed", "needed, since the first picture is blurred too")
    around: float = number(1.3, "times the first reach", "region of the body beyond the box of its points")


CLOCK, RUN_COST, BODY_MESH, BASE_FIT, SETTING = _Clock(), _RunCost(), _BodyMesh(), _BaseFit(), _Setting()
NUMERICAL_ERROR, SCREENING, SEARCH, DECISION = _NumericalError(), _Screening(), _Search(), _Decision()
EVIDENCE, LOCALISATION, PICTURES = _Evidence(), _Localisation(), _Pictures()
VERDICT = _Verdict()
_GROUPS: dict[str, Numbers] = {
    "clock": CLOCK, "run_cost": RUN_COST, "body_mesh": BODY_MESH, "base_fit": BASE_FIT, "setting": SETTING,
    "numerical_error": NUMERICAL_ERROR, "screening": SCREENING, "search": SEARCH, "decision": DECISION,
    "evidence": EVIDENCE, "verdict": VERDICT, "localisation": LOCALISATION, "pictures": PICTURES,
}  # fmt: skip


def thresholds_json() -> dict[str, JsonValue]:
    """All values by group and name, for the report."""
    return {group: to_jsonable_python(asdict(numbers)) for group, numbers in _GROUPS.items()}


def thresholds_table() -> str:
    """All values as a Markdown table: group, name, value, unit, reason."""
    rows = ["| group | name | value | unit | |", "|---|---|---|---|---|"]
    for group, numbers in _GROUPS.items():
        for one in fields(numbers):
            unit, reason = one.metadata["unit"], one.metadata["reason"]
            rows.append(f"| {group} | `{one.name}` | {getattr(numbers, one.name)} | {unit} | {reason} |")
    return "\n".join(rows)
