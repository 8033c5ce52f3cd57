"""Blind banks: the seal holds, classes are declared, scores count what they say."""

import json

import numpy as np
import pytest

from physconvex.capture import load_capture
from physconvex.errors import InputError
from physconvex.gap.blind import bank, diagnose_bank, generate_bank, score_bank
from physconvex.gap.blind.cases import draw_case
from physconvex.gap.blind.classes import same_class
from physconvex.gap.blind.scoring import _share_of


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A bank of three captures whose motion is made up."""

    def made_up(case, **_):
        from physconvex.gap import Motion

        points = np.asarray(case.surface.vertices)[:12]
        positions = np.repeat(points[None], case.frames, axis=0)
        return Motion(points, np.arange(case.frames) / case.fps, positions, 0 * positions), positions

    monkeypatch.setattr(bank, "simulate_case", made_up)
    generate_bank(tmp_path / "captures", tmp_path / "seal.json", count=3, seed=1, effect_free=0.34, engine="fem",
                  controls=["density", "noise"])  # fmt: skip
    return tmp_path


def test_captures_tell_nothing_of_their_labels(small):
    labels = json.loads(json.loads((small / "seal.json").read_text())["labels"])
    assert sorted(bool(label["effects"]) for label in labels[:3]) == [False, True, True]
    for label in labels:
        folder = small / "captures" / label["capture"]
        capture = load_capture(folder)
        assert capture.tracks() is not None and capture.mesh() is not None
        texts = "".join(p.read_text() for p in folder.glob("*.json"))
        assert not (folder / "truth.json").exists()
        assert not any(effect["name"] in texts.replace('"initial_velocity"', "") for effect in label["effects"])


def answers_of(small, first):
    labels = json.loads(json.loads((small / "seal.json").read_text())["labels"])
    answers = []
    for label in labels:
        name = first(label)
        effects = (
            [{"name": name, "source": "observation", "probability": 0.9, "parameters": [], "confused_with": []}]
            if name
            else []
        )
        answers.append({
            "capture": label["capture"], "verdict": "effect" if name else "none", "effects": effects,
            "ranking": [[name]] if name else [], "shrinkage": 0.9, "placebo": 0.0, "visibility": 10.0,
            "log10_youngs_modulus": [5.0, 5.0], "poisson_ratio": [0.3, 0.3], "seconds": 1.0,
        })  # fmt: skip
    path = small / "answers.json"
    text = json.dumps(answers, indent=1)
    path.write_text(json.dumps({"sha256": bank.digest(text, ""), "answers": answers}))
    return path


def test_right_answers_score_one(small):
    path = answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = score_bank(small / "captures", small / "seal.json", path)
    assert (found.with_effect, found.effect_free) == (2, 1)
    assert found.top_1 == found.top_1_merged == found.called == 1 and found.false_alarms == 0


def test_wrong_answers_score_nothing(small):
    path = answers_of(small, lambda label: "exposure")
    found = score_bank(small / "captures", small / "seal.json", path)
    assert found.top_1 == found.called == 0 and found.false_alarms == 1


def test_controls_change_what_they_say_and_nothing_else(small):
    labels = json.loads(json.loads((small / "seal.json").read_text())["labels"])
    assert [label["control"] for label in labels] == [None, None, None, "density", "noise"]
    density, again = labels[3], labels[4]
    assert load_capture(small / "captures" / density["capture"]).density == pytest.approx(1600)
    first, second = (load_capture(small / "captures" / c) for c in (again["repeats"], again["capture"]))
    change = second.tracks().positions - first.tracks().positions
    sigma = np.median(first.tracks().sigma)
    assert again["effects"] and change.std() == pytest.approx(np.sqrt(2) * sigma, rel=0.1)
    assert second.density == first.density and np.array_equal(first.tracks().rest, second.tracks().rest)


def test_controls_are_scored(small):
    path = answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = score_bank(small / "captures", small / "seal.json", path)
    assert [(c.name, c.right) for c in found.controls] == [("density", True), ("noise", True)]
    path = answers_of(small, lambda label: f"other {label['capture']}")
    found = score_bank(small / "captures", small / "seal.json", path)
    assert [(c.name, c.right) for c in found.controls] == [("density", False), ("noise", False)]


def test_shuffled_labels_fall_to_chance(small):
    path = answers_of(small, lambda label: label["effects"][0]["name"] if label["effects"] else None)
    found = score_bank(small / "captures", small / "seal.json", path)
    assert found.top_1_merged == 1 and found.shuffled == 0


def test_an_effect_without_a_name_counts_as_outside(small):
    path = answers_of(small, lambda label: None)
    hidden = [e["name"] for label in json.loads(json.loads((small / "seal.json").read_text())["labels"])[:3]
              for e in label["effects"]]  # fmt: skip
    content = json.loads(path.read_text()) | {"without": hidden[:1]}
    path.write_text(json.dumps(content))
    found = score_bank(small / "captures", small / "seal.json", path)
    assert found.outside == 1 and found.unknown == 1 and found.with_effect == 1


def test_changed_labels_and_answers_are_refused(small):
    path = answers_of(small, lambda label: None)
    content = json.loads(path.read_text())
    content["answers"][0]["verdict"] = "effect"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="were changed"):
        score_bank(small / "captures", small / "seal.json", path)
    sealed = json.loads((small / "seal.json").read_text())
    sealed["labels"] = sealed["labels"].replace("capture_000", "capture_001")
    (small / "seal.json").write_text(json.dumps(sealed))
    with pytest.raises(InputError, match="other captures"):
        score_bank(small / "captures", small / "seal.json", path)


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
    plan = bank._plan(np.random.default_rng(0), 20, ["friction", "wind", "attached_mass"],
                      {"free": 0.2, "two": 0.2, "outside": 0.1})  # fmt: skip
    assert len(plan) == 20 and plan.count(()) == 4
    pairs = [names for names in plan if len(names) == 2]
    assert len(pairs) == 4 and not any({"attached_mass", "friction"} <= set(names) for names in pairs)
    assert sum(names == ("tether",) for names in plan) == 2


def test_two_effects_are_counted_by_class():
    assert _share_of(["wind", "friction"], ["gravity_tilt"]) == 0.5
    assert _share_of([], ["friction"]) == 0.0


@pytest.mark.slow
def test_doses_follow_visibility(monkeypatch):
    from physconvex.gap.blind import explicit_cases

    monkeypatch.setattr(explicit_cases, "_NODES", (40, 60))
    simulate_explicit = explicit_cases.simulate_explicit
    case = draw_case(3, ("time_offset",), dosed=False)
    _, seen, hidden, visibility = simulate_explicit(case, ("time_offset",), 6.0)
    assert 4 < visibility < 9 and hidden.hidden[0].name == "time_offset" and np.isfinite(seen).all()
    stronger = simulate_explicit(case, ("time_offset",), 12.0)[2]
    assert abs(stronger.hidden[0].doses[0]) > 1.5 * abs(hidden.hidden[0].doses[0])
