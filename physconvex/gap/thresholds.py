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
    """Clock time: each stage ends at its share of `GapOptions.deadline`."""

    base_fit_ends: float = number(0.45, "of the deadline", "leaves the search half of the time")
    search_ends: float = number(0.6, "of the deadline", "leaves a quarter of the time for full-order fits")
    decision_ends: float = number(0.85, "of the deadline", "leaves time for the placebo and the report")
    placebo_ends: float = number(0.95, "of the deadline", "leaves time for the report")


@dataclass(frozen=True)
class _RunCost(Numbers):
    """Counted cost of runs. Pairs are for the (full-order, reduced) model."""

    full_step: float = number(5e-6, "s per node", "a Newton step of the base law, measured on 200 to 1500 nodes")
    reduced_step: float = number(4.5e-4, "s", "the same of the reduced model, with what a fit does around it")
    damping: Pair = number((0.35, 1.6), "steps", "a stiffness of its own")
    other_law: Pair = number((4.0, 2.5), "steps", "no fast arithmetic")
    flow: Pair = number((0.3, 3.5), "steps", "internal variables, beside the law's own stretches")
    stretches: Pair = number((4.5, 11.0), "steps", "a corotated law decomposes every sample")
    failed: int = number(4, "Newton steps per time step", "a run that did not converge")
    placebo: float = number(30.0, "s", "the fit of the placebo")
    held: float = number(1.5, "of a search", "runs of a held body cost a third of what they are counted as")
    longest_fit: float = number(0.15, "of a search", "one fit must not use up the search")
    after_moving: float = number(0.5, "of a search", "what a far fit adds once errors are taken anew there")
    leaving_out: float = number(0.2, "of a search", "always left for fits without one of the best effects")


@dataclass(frozen=True)
class _BodyMesh(Numbers):
    """The regular mesh of a box-shaped body."""

    box: float = number(2e-3, "of volume and of size", "so little a box misses of its bounding box")
    slender: float = number(3.0, "longest edge over the others", "one quadratic cell across is then enough")
    slender_cell: float = number(0.4, "length over width", "of a slender box's cells")
    several_across: float = number(4 / 3, "times the nodes", "allowed for several cells across a slender box")
    most_cells: int = number(16, "along an edge", "keeps the search over cells small")
    plane: float = number(5e-3, "of an edge", "a held part thinner than this is a plane, not a part")


@dataclass(frozen=True)
class _BaseFit(Numbers):
    """The fit of the base model, and its residuals."""

    most_frames: int = number(100, "frames", "open-loop models part from long recordings anyway")
    fewest_frames: int = number(6, "frames", "fewer cannot be fitted, chosen by and reported on")
    steps_per_wave: int = number(8, "steps", "in the time an elastic wave takes through a free body")
    steps_per_wave_held: int = number(4, "steps", "a held body bends slowly and is not struck")
    most_steps: int = number(1000, "steps of a roll-out", "what a run may take")
    starts_held: int = number(3, "starts", "a vibration that is off by a period has other minima")
    rounds: int = number(3, "rounds", "full-order run, then search with the reduced model")
    still: float = number(0.02, "typical steps", "a smaller change of the values is none")
    usual_poisson_ratio: Pair = number((0.15, 0.47), "", "beyond it a valley that a missing effect opened is likely")
    held_poisson_ratio: Pair = number((0.4, 0.1), "mean and deviation", "soft bodies; bending does not tell it")
    searches_itself: float = number(1.5, "times the coarse nodes", "a mesh no larger needs no cheaper model")
    flying: float = number(2e-3, "of the way travelled", "error of a rough model in flight")
    touched: float = number(0.01, "of the size", "error of a rough model once it has touched something")
    near: float = number(2e-3, "of the size", "so near to an obstacle counts as touching it")
    pushed: float = number(0.2, "of gravity", "what only a contact does, should it end between two frames")
    pixel_error: float = number(1.0, "pixels", "a followed point drifts by more than one step's error")
    fewest_points: int = number(6, "points", "fewer in a frame tell little")
    off_body: float = number(0.3, "of the size", "markers further from its bounding box are not on it")
    noise_in_doubt: float = number(1.5, "times the stated noise", "frame 0 is at rest: more is noise not stated")
    points_for_noise: int = number(8, "markers", "fewer leave no residual of an affine fit to tell noise from")
    starts_off: Pair = number((3.0, 4.0), "deviations", "in all, and as a shift: more is no noise")
    lasting_points: float = number(0.25, "of the first frame's points", "fewer are said to be lost")
    deep: float = number(0.02, "of the size", "markers so deep in the floor refute a stiff one")


@dataclass(frozen=True)
class _Setting(Numbers):
    """Unstated conditions of the recording: floor, elements, masses, strong damping."""

    rounds: int = number(2, "rounds", "derivatives of a joint fit taken anew once")
    full_runs: int = number(6, "runs", "a short full-order fit")
    soft_depth: float = number(0.01, "of the size", "markers lie deeper in a floor that gives way")
    soft_stiffness: float = number(1 / 3, "of the base model's floor", "a stiffer one does not give way")
    better: float = number(0.7, "of the squares", "left by a giving floor, or by own elements, to be believed")
    moduli: Row = number((0.0, 0.25, 0.45, 0.6, 0.75), "decades of E", "a hard floor makes the body too soft")
    stiffnesses: Row = number((-0.7, -0.3, 0.1), "decades", "about the one that stops the body at the depth seen")
    dashpots: Row = number((0.0, 1.0, 3.0), "times to sink in", "scanned with both")
    poisson_ratio: Pair = number((0.3, 0.45), "", "ν at which a scan over floor or damping begins")
    fits: int = number(2, "fits", "from the best of a scan")
    damping: float = number(0.15, "wave times", "scanned at every modulus")
    other_damping: Pair = number((0.05, 0.4), "wave times", "scanned about the best modulus")
    damped_better: float = number(0.6, "of the squares", "left by damping to be taken along")
    own_work: int = number(600_000, "nodes times steps", "own elements that can be afforded")
    own_better: float = number(0.5, "of the squares", "left by own elements of a held body to be the model")
    equal_masses: float = number(0.8, "of the squares", "left by equal masses of the nodes to be the recording's")
    own_moduli: Row = number((0.0, 0.04, -0.04, 0.1, -0.1), "decades of E", "about the one of equal frequency")
    surrogate_moduli: Row = number((-0.04, -0.02, 0.0, 0.02, 0.04), "decades of E", "of the cheaper model")
    own_poisson_ratio: Pair = number((0.25, 0.45), "", "ν at which a fit on other elements begins")
    hopeless: float = number(4.0, "times the squares", "by the best E: then no fit on other elements is begun")


@dataclass(frozen=True)
class _NumericalError(Numbers):
    """Errors of residuals without any effect."""

    fine_work: int = number(600_000, "nodes times steps", "a full-order run that is made some twenty times")
    exact_work: int = number(1_000_000, "nodes times steps", "runs with a quarter of these steps, some ten times")
    order: float = number(1.75, "", "of convergence by edge length; contact lowers it below two")
    finest: float = number(2.5, "times the finer mesh's nodes", "the mesh that is compared with it")
    exact_refinement: int = number(4, "steps for one", "of the most exact run")
    exact_left: float = number(0.2, "of the difference", "error of the most exact run's steps")
    steps_left: float = number(0.5, "of the difference", "error of half the time step")
    lasting: float = number(2.0, "frames", "for which a numerical error stays much the same")
    out_of_step: Row = number(
        (0.01, 0.1, 0.5), "of way, strain, finer shape", "by which this model, another engine and MuJoCo part"
    )
    sideways: float = number(0.2, "of that along the normal", "nine effect-free bodies parted less across it")
    forgiven_rebound: float = number(3.0, "times the expected error", "the most seen of programs without any effect")
    freedom: Row = number((6.0, 6.0, 12.0) * 2, "numbers per frame", "rigid, even strain, finer; then once struck")
    freedom_along: float = number(4.0, "numbers per frame", "a struck body along the normal, and turning")
    freedom_across: float = number(2.0, "numbers per frame", "a struck body across the normal")
    freedom_undivided: float = number(12.0, "numbers per frame", "as good as affine in space")
    fewest_divided: int = number(18, "residuals of a frame", "fewer are not worth dividing into kinds")
    scale_margin: float = number(4.0, "of squares", "chance absorption of error must not be called a cause")
    least_scale: float = number(0.15, "", "a smaller scale of the errors is not believed")
    free_residuals: float = number(0.1, "of the independent ones", "left over by unknowns, at least")
    scale_frames: int = number(2, "frames", "above noise, from which on they tell the scale")
    fit_anew: float = number(0.8, "", "scale of the errors from which on down the base fit is made anew")
    absorbed: float = number(1e-3, "of the size", "precision with which two meshes are fitted to each other")

    @property
    def fine_over_finest(self) -> float:
        """Error of the finer mesh over that of the finest one."""
        return float(self.finest ** (self.order / 3))


@dataclass(frozen=True)
class _Screening(Numbers):
    """Scores of effects."""

    same_as_placebo: float = number(0.7, "|cosine|", "a placebo must look otherwise than the effects")
    in_sight: float = number(3.0, "standard errors", "a dose that would have been seen")
    pairs_ranked: int = number(40, "pairs", "by one regression each")


@dataclass(frozen=True)
class _Search(Numbers):
    """Fits of effects by the reduced model, and their starts."""

    closed: float = number(1.5, "of the expected square", "below, the base fit leaves no gap to explain")
    wide: float = number(3.0, "of the expected square", "in fitted frames: a further effect is looked for")
    late: float = number(5.0, "of the expected square", "in frames that choose: a late impact shows there")
    left: float = number(6.0, "nats", "left to gain: a further effect is looked for")
    worth: float = number(4.0, "nats", "gain for which the search goes on")
    as_good: float = number(4.0, "nats", "a fit without one of the effects may lack so much and stand")
    followed: float = number(1.5, "of the expected square", "up to it nothing is left of a kind of residuals")
    singles: int = number(7, "effects", "fitted alone")
    stems: int = number(2, "fits", "the first further round goes on from")
    pairs: int = number(4, "fits", "of two effects at once")
    added: int = number(3, "fits", "in each further round")
    early: int = number(4, "fits", "from the first frames")
    elsewhere: int = number(4, "starts", "other places of an effect that is somewhere in the body")
    polished: int = number(3, "fits", "with derivatives taken anew")
    telling_points: int = number(4, "points", "fewer tell no strain from a motion as a whole")
    rounds_held: int = number(6, "rounds", "of the fit of a held body")
    rounds_placed: int = number(3, "rounds", "of what lies somewhere in another body, or along something")
    still: float = number(0.98, "of the misfit", "above, another round is not worth it")
    settled: float = number(0.7, "of the doubt", "above, another round is not worth it")
    slight: float = number(0.5, "nats", "gain below which another round is not worth it, of a free body")
    sure: float = number(2.0, "", "doubt below which priors weigh as they are")
    far: float = number(5.0, "typical steps", "most that other values are moved by beside a screened dose")
    moved: float = number(0.3, "typical steps", "from which on another start is tried")
    least_dose: float = number(0.2, "of the trial dose", "with which a fit begins, so that the effect is there")
    most_dose: float = number(8.0, "trial doses", "with which a fit begins")
    early_told: float = number(0.015, "decades of E", "standard error at which the first frames tell E")
    early_longest: float = number(0.75, "of the fitted frames", "a longer window would be the base fit again")
    early_apart: float = number(0.04, "decades of E", "that make another fit another point")
    far_modulus: float = number(0.5, "decades of E", "from the base fit: numerical errors are taken anew")
    flight_frames: int = number(5, "frames", "the shortest flight that is fitted by itself")
    flight_open: float = number(2.0, "of the expected square", "from which on the flight says something")
    flight_screened: tuple[int, int] = number((3, 6), "single effects, pairs", "fitted to the flight")
    flight_fitted: tuple[int, int] = number((1, 2), "single effects, pairs", "fitted on from there")
    flight_contact: int = number(4, "frames", "of the contact that tell about where E is")
    flight_moduli: Row = number((-1.8, 1.9, 0.3), "decades of E", "start, end, step about the base fit's")
    flight_moduli_full: Row = number((0.0, 0.1, 0.2, 0.3), "decades of E", "a full-order model is less stiff")
    flight_poisson_ratio: float = number(0.35, "", "ν beside them")
    load_ratios: Row = number((0.0, 0.03, 0.06, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2), "of the body's mass", "scanned")
    load_slacks: Row = number((0.5, 1.0, 2.0, 3.0), "trial slacks", "scanned")
    load_step: float = number(0.05, "decades of E", "about the E of the recorded frequency")
    load_farthest: int = number(4, "such steps", "a body that sags far swings otherwise")
    load_moduli: Pair = number((3.0, 8.0), "log10 Pa", "bounds of that scan")


@dataclass(frozen=True)
class _Decision(Numbers):
    """Fits by the full-order model."""

    tied: float = number(1.0, "nats", "hardly tells two forms of an effect apart")
    forms: int = number(3, "forms", "of a single effect of a struck body: the reduced model is off by ten there")
    hopeless: float = number(25.0, "nats", "behind the best fit: nothing more is made of it")
    sweeps: int = number(5, "sweeps", "over the full-order fits")
    slow: float = number(1.0, "nats", "gain below which a further sweep is not worth it")
    rounds: int = number(2, "rounds", "of full-order run and search")
    still: float = number(0.02, "typical steps", "a smaller change of the values is none")
    diverged: float = number(1.5, "of the best mean square", "from which on such rounds end")


@dataclass(frozen=True)
class _Evidence(Numbers):
    """Evidence of residuals."""

    unseen: float = number(0.01, "of the expected square", "a smaller change of a kind tells nothing")
    enough: float = number(1.0, "of the expected square", "a better fit need not undercut it")
    smooth: float = number(1 / 3, "of the frames", "what a smooth residual counts for at least")
    anything: int = number(8, "doses and effects", "that an unknown effect is priced at")
    ringing_frames: int = number(8, "frames", "that a damped sine is fitted to, at least")
    ringing_explained: float = number(0.5, "of a signal", "explained by a damped sine to be one")
    main_shape: float = number(0.5, "of the squares", "of the deformation, for its ringing to count")
    frequency_told: float = number(0.05, "relative error", "above, the recording does not tell the frequency")
    frequency_missed: float = number(0.05, "of the frequency", "what a good model may miss")
    damping_missed: float = number(0.5, "of the damping ratio", "what a good model may miss")
    least_damping_missed: float = number(0.02, "damping ratio", "what a good model may miss at least")
    ringing_farthest: float = number(6.0, "standard deviations", "that count")


@dataclass(frozen=True)
class _Verdict(Numbers):
    """The rules from fits to an answer."""

    weak: float = number(1.5, "nats", "a gain that leaves open whether an effect is there")
    clear: float = number(4.0, "nats", "a gain that makes a call")
    telling: float = number(10.0, "nats", "makes a call within the expected error, if half of the gap goes")
    soft_floor: float = number(10.0, "nats", "less may follow what the law of a soft contact is")
    foretold: float = number(0.9, "of the held-out gap", "removed: no doubt, if a placebo removes no tenth")
    abundant: float = number(0.8, "of the share asked for", "at twice the gain that is enough")
    placebo: float = number(0.5, "of the effect's share", "a placebo that does more speaks against the effect")
    placebo_left: float = number(0.25, "of what a placebo leaves", "left by a sure effect at most")
    certain: float = number(0.95, "probability", "from which on such a placebo is no objection")
    likely: float = number(0.5, "probability", "from which on an effect is named")
    listed: float = number(0.02, "probability", "from which on an effect is listed as possible")
    rival: float = number(0.1, "probability", "from which on a single effect is one of confusion")
    doubt: float = number(0.4, "probability", "of none and something else, above which none is called")
    trusted: float = number(0.94, "of calls", "are right: 59 of 63 in blind banks, nearly all with 1.00 by evidence")
    floor: float = number(1.5, "of the expected square", "less is no gap")
    left_over: float = number(2.0, "of the expected square", "what is left is a gap, after effects")
    open: float = number(4.0, "of the expected square", "a gap, whether or not an effect explains it")
    seen: float = number(1.5, "rms of the expected error", "held out: from here a body that strikes nothing has a gap")
    wide: float = number(4.0, "rms of the expected error", "held out: a gap that no fit argues away")
    blind: float = number(0.1, "of size or motion", "numerical error above which `none` says nothing")
    astray: float = number(0.5, "of the motion", "off the recording by more: no model of it")
    flight_closed: float = number(2.0, "of the expected square", "up to it a flight is followed")
    alike: float = number(0.95, "cosine of signatures", "two effects that are not told apart")
    alike_as_declared: float = number(0.85, "cosine of signatures", "the same of two declared to look alike")
    form: float = number(0.02, "of a dose", "what two programs that mean the same effect differ by")
    form_deforming: float = number(0.05, "of a dose", "the same of what deforms or touches, and of held bodies")
    absorbed: float = number(0.15, "relative change of E", "from which on a caveat tells that E had absorbed part")


@dataclass(frozen=True)
class _Localisation(Numbers):
    """Location of the gap."""

    shapes: int = number(3, "shapes", "of the deformation that are told")
    shape_share: float = number(0.02, "of the squares", "smaller shapes are left out")


@dataclass(frozen=True)
class _Pictures(Numbers):
    """Effects in the light of a video."""

    clear: float = number(4.0, "nats", "gain that makes a call")
    placebo: float = number(0.5, "of the effect's share", "reached by a wrong direction at most")
    doses: int = number(9, "doses", "at which an effect is put into the patches")
    fewest_patches: int = number(5, "patches", "in a frame, to count it")
    fewest_frames: int = number(6, "frames", "to tell anything")
    brightness_error: float = number(0.01, "log of the light", "without any effect")
    smear_error: float = number(0.1, "log of the ratio", "without any effect")
    dark: float = number(8.0, "grey value", "below it a picture does not tell its light")
    bright: float = number(247.0, "grey value", "above it a picture does not tell its light")
    faster: float = number(2.0, "times the first speed", "the first picture is smeared itself")
    around: float = number(1.3, "times the first reach", "of the body beyond the box of its points")


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
