"""Blind banks: the seal holds, classes are declared, scores count what they say."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen import BankOptions, Shares, generate_bank, same_class
from data_gen.blind import bank, explicit_cases
from data_gen.blind.cases import draw_case
from data_gen.blind.controls import class_of
from data_gen.blind.engine import run_explicit
from data_gen.blind.explicit_cases import _seen_effect
from data_gen.blind.plan import plan_bank
from physconvex import ConvergenceError, InputError
from physconvex.gap import DEFAULT_EFFECTS, PointMotion
from physconvex.io import load_capture
from train import Bank, area_under_roc, diagnose_bank, run_oracle, score_banks
from train.blind import answers, oracle
from train.blind.answers import likeliest_known
from train.blind.command import app
from train.blind.metrics import calibration_error, proportion, reliability
from train.blind.rows import score_doses, share_of
from train.blind.summary import draw_score, pool_scores, score_json, score_markdown


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A bank of three captures whose motion is made up."""

    def made_up(case, **_):
        points = np.asarray(case.surface.vertices)[:12]
        positions = np.repeat(points[None], case.frames, axis=0)
        return PointMotion(points, np.arange(case.frames) / case.fps, positions, 0 * positions), positions

    monkeypatch.setattr(bank, "simulate_case", made_up)
    make(tmp_path)
    return tmp_path


def make(folder, **changes):
    settings = {"count": 3, "seed": 1, "shares": Shares(free=0.34), "engine": "fem", "controls": ["density", "noise"]}
    return generate_bank(folder / "captures", folder / "seal.json", BankOptions(**settings | changes))


def scored(folder):
    return score_banks(Bank(folder / "captures", folder / "seal.json", folder / "answers.json"))


def labels_of(folder):
    return json.loads(json.loads((folder / "seal.json").read_text())["labels"])


def test_captures_tell_nothing_of_their_labels(small):
    labels = labels_of(small)
    assert sorted(bool(label["effects"]) for label in labels[:3]) == [False, True, True]
    for label in labels:
        folder = small / "captures" / label["capture"]
        capture = load_capture(folder)
        assert capture.tracks() is not None and capture.mesh() is not None
        texts = "".join(p.read_text() for p in folder.glob("*.json"))
        assert not (folder / "truth.json").exists()
        assert not any(effect["name"] in texts.replace('"initial_velocity"', "") for effect in label["effects"])


def told(label, name):
    """The hidden doses, if this is what is hidden."""
    return [
        {"unit": unit, "value": 1.1 * dose, "interval": sorted((1.05 * dose, 1.2 * dose))}
        for effect in label["effects"]
        if effect["name"] == name
        for dose, unit in zip(effect["doses"], effect["units"], strict=True)
    ]


def answers_of(small, first):
    labels = labels_of(small)
    answers = []
    for label in labels:
        name = first(label)
        effects = (
            [
                {
                    "name": name,
                    "source": "observation",
                    "probability": 0.9,
                    "parameters": told(label, name),
                    "confused_with": [],
                }
            ]
            if name
            else []
        )
        answers.append({
            "capture": label["capture"], "verdict": "effect" if name else "none", "effects": effects,
            "ranking": [[name]] if name else [], "shrinkage": 0.9, "placebo": 0.0,
            "gap_before": 1e-2, "gap_after": 2e-3, "noise_floor": 1e-3, "none_probability": 0.0,
            "known": 0.9 if name else 0.0, "log10_youngs_modulus": [5.0, 5.0], "poisson_ratio": [0.3, 0.3],
            "seconds": 1.0,
        })  # fmt: skip
    path = small / "answers.json"
    text = json.dumps(answers, indent=1)
    path.write_text(json.dumps({"sha256": bank.digest(text, ""), "answers": answers}))
    return path


def visible(small):
    """The same bank with labels that say so: made-up motion has no visibility."""
    sealed = json.loads((small / "seal.json").read_text())
    labels = [label | {"wanted": 10.0} for label in json.loads(sealed["labels"])]
    sealed["labels"] = json.dumps(labels, indent=1)
    (small / "seal.json").write_text(json.dumps(sealed))
    commitment = json.loads((small / "captures" / bank.COMMITMENT).read_text())
    commitment["sha256"] = bank.digest(sealed["labels"], sealed["salt"])
    (small / "captures" / bank.COMMITMENT).write_text(json.dumps(commitment))


def test_right_answers_score_one(small):
    visible(small)
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = scored(small)
    assert (found.top_1.count, found.false_alarms.count) == (2, 1)
    assert found.top_1.value == found.top_1_merged.value == found.called.value == 1 and found.false_alarms.value == 0
    assert found.top_1.lower < 0.5 and found.failures == ()
    assert sorted(row.right_first.value for row in found.by_effect) == [1, 1]


def test_wrong_answers_score_nothing(small):
    visible(small)
    answers_of(small, lambda label: "exposure")
    found = scored(small)
    assert found.top_1.value == found.called.value == 0 and found.false_alarms.value == 1
    assert found.calls_right.value == 0 and len(found.failures) == 3
    assert found.calibration_error == pytest.approx(0.9)
    assert {first for _, first, _ in found.confusion} == {"exposure"}


def test_what_the_material_is_off_by_has_a_sign(small):
    visible(small)
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    off = [0.3 - label["poisson_ratio"] for label in labels_of(small)[:3] if label["effects"]]
    found = scored(small).bias["poisson_ratio, one effect"]
    assert found.mean == pytest.approx(np.mean(off)) and found.deviation == pytest.approx(np.std(off))
    assert found.median == pytest.approx(np.mean(np.abs(off))) and found.most < np.max(np.abs(off))
    assert f"| {found.mean:+.3f} ± {found.deviation:.3f}; " in score_markdown(scored(small))


def test_captures_that_are_less_visible_count_by_visibility_alone(small):
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    labels = [label | {"wanted": 3.0} for label in labels_of(small)]
    sealed = {"salt": "", "labels": json.dumps(labels)}
    (small / "seal.json").write_text(json.dumps(sealed))
    (small / "captures" / bank.COMMITMENT).write_text(json.dumps({"sha256": bank.digest(sealed["labels"], "")}))
    found = scored(small)
    assert found.top_1.count == 0 and found.calls_right.count == 2
    assert [v.right_first.count for v in found.by_visibility] == [0, 2, 0, 0]


def test_a_score_can_be_read(small):
    visible(small)
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = scored(small)
    text = score_markdown(found)
    assert "| class ranked first | 1.00 [0.34, 1.00] of 2 | ≥ .85 |" in text
    assert all(row.capture.replace("capture_", "") in text for row in found.rows)
    assert "nan" not in text  # no effect of which an oracle told
    draw_score(found, small / "score.png")
    assert (small / "score.png").stat().st_size > 10_000


def test_controls_change_what_they_say_and_nothing_else(small):
    labels = labels_of(small)
    assert [label["control"] for label in labels] == [None, None, None, "density", "noise"]
    density, again = labels[3], labels[4]
    assert load_capture(small / "captures" / density["capture"]).density == pytest.approx(1600)
    first, second = (load_capture(small / "captures" / c) for c in (again["repeats"], again["capture"]))
    change = second.tracks().positions - first.tracks().positions
    sigma = np.median(first.tracks().sigma)
    assert again["effects"] and change.std() == pytest.approx(np.sqrt(2) * sigma, rel=0.1)
    assert second.density == first.density and np.array_equal(first.tracks().rest, second.tracks().rest)


def test_controls_are_scored(small):
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = scored(small)
    assert [(c.name, c.right) for c in found.controls] == [("density", True), ("noise", True)]
    answers_of(small, lambda label: f"other {label['capture']}")
    found = scored(small)
    assert [(c.name, c.right) for c in found.controls] == [("density", False), ("noise", False)]


def test_the_oracle_tries_the_hidden_effect_alone(small, monkeypatch):
    visible(small)
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    asked = []

    def alone(folder, effects, options):
        asked.append((folder.name, *effects))
        if len(asked) == 1:
            raise ConvergenceError("no")
        return SimpleNamespace(how_far=(SimpleNamespace(shrinkage=0.75),))

    monkeypatch.setattr(oracle, "diagnose", alone)
    bank_of = Bank(small / "captures", small / "seal.json", small / "answers.json", small / "oracle")
    run_oracle(bank_of, small / "oracle")
    run_oracle(bank_of, small / "oracle")  # nothing is done twice
    hidden = [(label["capture"], label["effects"][0]["name"]) for label in labels_of(small)[:3] if label["effects"]]
    assert asked == hidden
    found = score_banks(bank_of)
    assert found.oracles == 1 and found.share_of_oracle == pytest.approx(0.9 / 0.75)


def test_the_command_scores_and_writes(small):
    visible(small)
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    files = {key: str(small / name) for key, name in (("out", "s.json"), ("tables", "s.md"), ("figure", "s.png"))}
    bank_of = {"captures": "captures", "seal": "seal.json", "answers": "answers.json"}
    arguments = ["score", *(a for key, name in bank_of.items() for a in (f"--{key}", str(small / name)))]
    result = CliRunner().invoke(app, [*arguments, *(a for key, name in files.items() for a in (f"--{key}", name))])
    assert result.exit_code == 0, result.output
    assert json.loads((small / "s.json").read_text())["top_1"]["value"] == 1.0
    assert (small / "s.md").read_text() in result.output and (small / "s.png").exists()
    result = CliRunner().invoke(app, [*arguments, "--captures", str(small / "captures")])
    assert isinstance(result.exception, InputError) and "one for each of 2 banks" in str(result.exception)


def test_an_interrupted_diagnosis_keeps_the_answers_so_far(small, monkeypatch):
    def interrupted(job):
        if job.name == "capture_001":
            raise KeyboardInterrupt
        job.target.mkdir(parents=True)
        (job.target / "error.txt").write_text("no use")

    monkeypatch.setattr(answers, "_diagnose", interrupted)
    with pytest.raises(KeyboardInterrupt):
        diagnose_bank(small / "captures", small)
    found = scored(small)
    assert [row.error for row in found.rows] == ["no use", "no answer", "no answer"] and found.errors == 3
    assert found.captures == 0 and not found.controls


def test_stored_scores_are_counted_together(small):
    """The score of one bank is got back from its file, doses and what is not known too; a second one adds to it."""
    visible(small)
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = scored(small)
    assert any(row.dose is not None for row in found.rows) and any(np.isnan(row.oracle) for row in found.rows)
    text = score_json(found)
    paths = [small / "first.json", small / "second.json"]
    paths[0].write_text(text)
    paths[1].write_text(text.replace(f'"{small.name}/capture_', '"other/capture_'))
    assert score_json(pool_scores(paths[:1])) == text
    both = pool_scores(paths)
    assert both.captures == 2 * found.captures and len(both.controls) == 2 * len(found.controls)
    assert both.top_1.count == 2 * found.top_1.count
    with pytest.raises(InputError, match=f"{small.name}/capture_000 is in two of them"):
        pool_scores([paths[0], paths[0]])
    with pytest.raises(InputError, match="got none"):
        pool_scores([])
    for spoiled in (text.replace('"verdict"', '"answer"'), "[]", '{"rows": [1]}', text.replace('"undrawn"', '"lost"')):
        paths[1].write_text(spoiled)
        with pytest.raises(InputError, match=r"second.json: no result of"):
            pool_scores(paths)
    result = CliRunner().invoke(app, ["pool", str(paths[0]), "--out", str(small / "pooled.json")])
    assert result.exit_code == 0 and (small / "pooled.json").read_text() == text, result.output


def test_shuffled_labels_fall_to_chance(small):
    visible(small)
    answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = scored(small)
    assert found.top_1_merged.value == 1 and found.shuffled == 0


def test_an_effect_without_a_name_counts_as_outside(small):
    path = answers_of(small, lambda label: None)
    hidden = [e["name"] for label in labels_of(small)[:3]
              for e in label["effects"]]  # fmt: skip
    content = json.loads(path.read_text()) | {"without": hidden[:1]}
    path.write_text(json.dumps(content))
    found = scored(small)
    assert found.outside_not_called.count == 1 and found.outside_not_called.value == 1
    assert found.outside_unknown.value == 0 and sum(row.single for row in found.rows) == 1


@pytest.mark.parametrize(("source", "verdict", "right"), [
    ("numerical", "none", 1.0), ("observation", "none", 0.0), ("numerical", "effect", 0.0),
])  # fmt: skip
def test_numerical_error_is_a_right_answer_where_nothing_is_hidden(small, source, verdict, right):
    """Another engine's captures differ by it; an answer that said so counted as a probability told wrongly."""
    path = answers_of(small, lambda label: None if label["effects"] else "mesh_resolution")
    answers = json.loads(path.read_text())["answers"]
    for answer in answers:
        for effect in answer["effects"]:
            answer["verdict"], effect["source"] = verdict, source
    path.write_text(json.dumps({"sha256": bank.digest(json.dumps(answers, indent=1), ""), "answers": answers}))
    found = scored(small)
    assert [(b.probability, b.right, b.count) for b in found.reliability] == [(0.9, right, 1)]
    assert found.false_alarms.value == (verdict == "effect")


@pytest.mark.parametrize(("others", "told"), [({"wind": 0.3}, 0.9), ({"wind": 0.4}, 0.94), ({"damping": 0.3}, 0.6)])
def test_a_class_is_told_with_the_probability_of_all_its_effects(small, others, told):
    """Either of two that look alike is a right answer, so that what they share counts for both."""
    path = answers_of(small, lambda label: "gravity_tilt" if label["effects"] else None)
    answers = json.loads(path.read_text())["answers"]
    for answer in answers:
        for effect in answer["effects"][:]:
            effect["probability"] = 0.6
            answer["effects"] += [effect | {"name": name, "probability": p} for name, p in others.items()]
    path.write_text(json.dumps({"sha256": bank.digest(json.dumps(answers, indent=1), ""), "answers": answers}))
    found = [row.probability for row in scored(small).rows if row.truth]
    assert found and found == pytest.approx([told] * len(found))


@pytest.mark.parametrize(("believed_in", "area"), [("what is known", 1.0), ("what is not", 0.0), ("none", 0.5)])
def test_an_unknown_effect_is_told_by_how_little_is_believed(small, believed_in, area):
    visible(small)
    gone = next(label["effects"][0]["name"] for label in labels_of(small) if label["effects"])

    def first(label):
        known = bool(label["effects"]) and label["effects"][0]["name"] != gone
        return "exposure" if believed_in != "none" and known == (believed_in == "what is known") else None

    path = answers_of(small, first)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"without": [gone]}))
    assert scored(small).unknown_auroc == area


def test_what_is_believed_is_read_from_the_fits_whatever_was_called():
    screening = [{"effect": "mesh_resolution", "source": "numerical"}, {"effect": "wind", "source": "external"}]

    def known(**evidence):
        fits = [{"effects": [n for n in key.split("__") if n], "evidence": e} for key, e in evidence.items()]
        return likeliest_known({"screening": screening, "hypotheses": fits})

    assert known(**{"wind": np.log(3.0), "": 0.0}) == pytest.approx(0.75)
    assert known(**{"wind": np.log(3.0), "wind__drag": np.log(4.0), "": 0.0}) == pytest.approx(7 / 8)
    assert known(**{"mesh_resolution": np.log(6.0), "wind": np.log(3.0), "": 0.0}) == pytest.approx(0.3)
    assert known(**{"": 0.0}) == known(**{"mesh_resolution": 9.0, "": 0.0}) == 0.0
    twice = [{"effects": ["wind"], "evidence": e} for e in (np.log(3.0), 0.0)] + [{"effects": [], "evidence": 0.0}]
    assert likeliest_known({"screening": screening, "hypotheses": twice}) == pytest.approx(0.75)


def test_changed_labels_and_answers_are_refused(small):
    path = answers_of(small, lambda label: None)
    content = json.loads(path.read_text())
    content["answers"][0]["verdict"] = "effect"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="were changed"):
        scored(small)
    sealed = json.loads((small / "seal.json").read_text())
    sealed["labels"] = sealed["labels"].replace("capture_000", "capture_001")
    (small / "seal.json").write_text(json.dumps(sealed))
    with pytest.raises(InputError, match="other captures"):
        scored(small)


def test_declared_classes():
    assert same_class("wind", "gravity_tilt") and not same_class("wind", "friction")


def test_draws_repeat():
    first, second = draw_case(5, ("friction",)), draw_case(5, ("friction",))
    assert first.hidden == second.hidden and first.youngs_modulus == second.youngs_modulus
    assert first.hidden[0].doses[0] > 0 and first.kind != "clamped"


def test_empty_folder(tmp_path):
    with pytest.raises(InputError, match="no capture folders"):
        diagnose_bank(tmp_path, tmp_path / "out")


def test_plan_holds_what_was_asked_for():
    shares = Shares(free=0.2, two=0.2, outside=0.1, deleted=0.2)
    plan = plan_bank(0, 20, ["friction", "wind", "attached_mass"], (3.0, 10.0), shares=shares)
    assert len(plan) == 20 and sum(p.effects == () for p in plan) == 4
    pairs = [p.effects for p in plan if len(p.effects) == 2]
    assert len(pairs) == 4 and not any({"attached_mass", "friction"} <= set(names) for names in pairs)
    assert sum(p.effects == ("tether",) for p in plan) == 2
    singles = [p for p in plan if len(p.effects) == 1 and not p.without and p.effects != ("tether",)]
    assert sorted((p.effects[0], p.visibility) for p in singles) == sorted(
        (name, v) for name in ("friction", "wind", "attached_mass") for v in (3.0, 10.0)
    )


def test_a_capture_with_new_noise_is_asked_with_the_same_dictionary(small):
    folder = small / "deleted"
    make(folder, shares=Shares(free=0, deleted=1), controls=["noise"])
    again = labels_of(folder)[-1]
    asked = json.loads((folder / "captures" / "dictionary.json").read_text())
    assert again["control"] == "noise" and again["repeats"] == "capture_000"
    assert asked[again["capture"]] == asked[again["repeats"]] != []


def test_new_noise_is_put_on_a_capture_that_could_be_drawn(small, monkeypatch):
    made_up, hiding = bank.simulate_case, [label["effects"] for label in labels_of(small)[:3]]
    first, second = (effects[0]["name"] for effects in hiding if effects)

    def at_times(case, **_):
        if case.hidden and case.hidden[0].name == first:
            raise ConvergenceError("it does not settle")
        return made_up(case)

    monkeypatch.setattr(bank, "simulate_case", at_times)
    folder = small / "at_times"
    assert make(folder) == 4
    *_, again = labels_of(folder)
    assert [effect["name"] for effect in again["effects"]] == [second] and "failed" not in again
    assert load_capture(folder / "captures" / again["capture"]).tracks() is not None


def test_what_is_taken_out_does_not_tell_what_is_hidden():
    plan = plan_bank(0, 20, ["friction", "wind"], (10.0,), shares=Shares(free=0.5, deleted=0.2))
    deleted = [p for p in plan if p.without and p.effects]
    decoys = [p for p in plan if p.without and not p.effects]
    assert len(deleted) == len(decoys) == 4
    assert all(p.without == class_of(p.effects[0]) for p in deleted)
    assert {p.without for p in decoys} == {p.without for p in deleted} == {("friction",), ("gravity_tilt", "wind")}


def test_shares_above_one_are_refused():
    with pytest.raises(InputError, match="at most one"):
        plan_bank(0, 10, ["friction"], (10.0,), shares=Shares(free=0.6, two=0.5))


def test_a_bank_goes_on_where_it_was_stopped(small, tmp_path, monkeypatch):
    again = tmp_path / "again"
    whole, real = {p.name: p.read_bytes() for p in small.glob("captures/*/tracks.npz")}, bank._make
    made = []

    def killed(job):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(job.name)
        real(job)

    monkeypatch.setattr(bank, "_make", killed)
    with pytest.raises(KeyboardInterrupt):
        make(again)
    assert not (again / "seal.json").exists()
    with pytest.raises(InputError, match="other settings"):
        make(again, seed=2)
    monkeypatch.setattr(bank, "_make", real)
    before = {name: (again / "captures" / name / "capture.json").stat().st_mtime_ns for name in made}
    assert make(again) == 5 and len(labels_of(again)) == 5
    assert before == {name: (again / "captures" / name / "capture.json").stat().st_mtime_ns for name in made}
    assert whole == {p.name: p.read_bytes() for p in again.glob("captures/*/tracks.npz")}
    assert labels_of(again) == labels_of(small)


def test_what_cannot_be_drawn_is_told(tmp_path, monkeypatch):
    def fails(case, **_):
        raise ConvergenceError("no")

    monkeypatch.setattr(bank, "simulate_case", fails)
    assert make(tmp_path, controls=[]) == 0
    assert all("8 draws could not be simulated" in label["failed"] for label in labels_of(tmp_path))


def test_doses_are_compared_as_vectors_in_one_unit():
    hidden = [(3.0, "deg"), (4.0, "deg"), (0.1, "m")]
    told = [{"unit": "deg", "value": 3.0, "interval": [2, 4]}, {"unit": "deg", "value": 4.5, "interval": [4.4, 4.6]},
            {"unit": "m", "value": 0.102, "interval": [0.09, 0.11]}]  # fmt: skip
    found = score_doses("camera_pose", hidden, told)
    assert found.error == pytest.approx(0.1) and found.covered == (True, False, True)


def test_logarithms_of_doses_are_taken_back():
    told = [{"unit": "log10 Pa", "value": 4.0, "interval": [3.9, 4.1]}]
    found = score_doses("plasticity", [(1.1e4, "Pa")], told)
    assert found.error == pytest.approx(0.1 / 1.1) and found.covered == (True,)


def test_other_quantities_are_not_compared():
    assert score_doses("air_drag", [(0.1, "1/m")], [{"unit": "1/s", "value": 1, "interval": [0, 2]}]) is None
    assert score_doses("friction", [(0.1, "")], [{"unit": "s", "value": 1, "interval": [0, 2]}]) is None


def test_figures_of_merit():
    assert area_under_roc([2, 3], [1, 2]) == pytest.approx(3.5 / 4) and np.isnan(area_under_roc([], [1]))
    share = proportion([True] * 8 + [False] * 2)
    assert (share.lower, share.upper) == pytest.approx((0.4902, 0.9433), abs=1e-4)  # Wilson, by hand
    bins = reliability([0.95, 0.95, 0.15], [True, False, False])
    assert [(b.probability, b.right, b.count) for b in bins] == [(0.15, 0, 1), (0.95, 0.5, 2)]
    assert calibration_error(bins) == pytest.approx((0.15 + 2 * 0.45) / 3)


def test_two_effects_are_counted_by_class():
    assert share_of(["wind", "friction"], ["gravity_tilt"]) == 0.5
    assert share_of([], ["friction"]) == 0.0


class _Shown:
    """Runs of a made-up body: three points whose positions are these in ten frames."""

    def __init__(self, shift, nodes=1):
        self.shift, self.mesh = shift, SimpleNamespace(vertices=np.zeros((nodes, 3)))

    def __call__(self, *effects, **changes):
        return None, np.zeros((10, 3, 3)) + self.shift(effects, changes)


@pytest.mark.wrong_types  # a stand-in for a runner
def test_what_is_fitted_anyway_does_not_make_an_effect_visible():
    falling, along = np.linspace(0, 1, 10)[:, None, None] ** 2, np.array([0.0, 0.0, 1.0])
    case = SimpleNamespace(
        youngs_modulus=1e5, poisson_ratio=0.3, size=1.0, velocity=(0, 0, 0), spin=(0, 0, 0), states_motion=True,
        height=0.1, noise=1e-3,
    )  # fmt: skip

    def shift(effects, changes):
        stiffer = changes.get("youngs_modulus", 1e5) / 1e5 - 1
        other = changes.get("poisson_ratio", 0.3) - 0.3
        softer = "contact_modulus" in changes
        return falling * along * stiffer + falling * np.eye(3)[0] * other + 2e-3 * softer

    coarse, fine = _Shown(shift), _Shown(lambda e, c: shift(e, c) + 3e-3 * np.eye(3)[1], 64)
    yardstick = explicit_cases._Yardstick.of(case, coarse, fine)
    assert yardstick.visibility(falling * (along - np.eye(3)[0]) + np.zeros((10, 3, 3))) == pytest.approx(0, abs=1e-12)
    # noise, a mesh whose error is 1/(64^½ − 1) of the difference, and what the floor gives, all but what is absorbed
    left = 1 - float(falling.sum()) ** 2 / float((falling**2).sum()) / 10
    floor = 3e-6 + (3e-3 / 7) ** 2 + 4e-6 * (1 + 2 * left)
    assert yardstick.floor == pytest.approx(floor)
    assert yardstick.visibility(np.zeros((10, 3, 3)) + 0.01 * np.eye(3)[1]) == pytest.approx(1e-4 / floor)


@pytest.mark.wrong_types  # a stand-in for a runner
def test_a_dose_is_found_beyond_a_threshold(monkeypatch):
    monkeypatch.setattr(explicit_cases, "_dosed", lambda name, strength, case, seed: strength)
    runner = _Shown(lambda effects, _: max(effects[0] - 0.15, 0) * 100)  # nothing at a fifth of a moderate dose
    yardstick = explicit_cases._Yardstick(np.zeros((10, 3, 3)), np.zeros((90, 1)), 1.0)
    seen, dose = explicit_cases._scaled("plasticity", None, runner, yardstick, visibility=30.0, number=0)
    assert 15 < seen < 60 and 0.15 < dose < 0.3
    tried = []
    nothing = _Shown(lambda effects, _: tried.append(effects[0]) or 0.0)
    with pytest.raises(ConvergenceError, match="30 wanted"):
        explicit_cases._scaled("plasticity", None, nothing, yardstick, visibility=30.0, number=0)
    assert tried == [1.0, 5.0, explicit_cases._STRONGEST]  # which is not run again


@pytest.mark.slow
def test_doses_follow_visibility(monkeypatch):
    monkeypatch.setattr(explicit_cases, "_NODES", (40, 60))
    simulate_explicit = explicit_cases.simulate_explicit
    case = draw_case(3, ("time_offset",), dosed=False)
    _, seen, hidden, visibility = simulate_explicit(case, ("time_offset",), 6.0)
    assert 4 < visibility < 9 and hidden.hidden[0].name == "time_offset" and np.isfinite(seen).all()
    stronger = simulate_explicit(case, ("time_offset",), 24.0)[2]
    assert abs(stronger.hidden[0].doses[0]) > 1.5 * abs(hidden.hidden[0].doses[0])


@pytest.mark.parametrize("name", ["camera_pose", "time_offset", "time_scale"])
def test_doses_of_what_is_seen_mean_what_they_mean_in_the_dictionary(name):
    rng = np.random.default_rng(3)
    case = draw_case(3, (name,), dosed=False)
    runner = explicit_cases._Runner(case, explicit_cases._mesh(case, 40), case.surface.vertices[:12])
    dosed = _seen_effect(name, 1.0, case, rng)
    world = explicit_cases._world(case, runner.mesh)
    steps = run_explicit(world, runner.points, frames=24 * case.frames, fps=24 * case.fps)  # some frames further
    motion = PointMotion.of_steps(steps, case.frames, 24)
    effect = next(e for e in DEFAULT_EFFECTS if e.name == name)
    expected = effect.observe(motion, np.array(dosed.doses))
    np.testing.assert_allclose(runner(dosed)[1], expected, atol=1e-4 * case.size)
    assert np.abs(expected - motion.positions).max() > 1e-3 * case.size
