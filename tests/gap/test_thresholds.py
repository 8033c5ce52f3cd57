"""Numbers that a diagnosis decides by stand in one place, with unit and reason."""

import ast
import json
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

import physconvex.gap.thresholds as thresholds
from physconvex.gap.thresholds import VERDICT, thresholds_json, thresholds_table

GAP = Path(thresholds.__file__).parent
GROUPS = [group for name, group in vars(thresholds).items() if name.isupper() and is_dataclass(group)]
# numbers that decide nothing, and why
ELSEWHERE = {
    "base/body_modes.py": {
        "_RIGID": "an index", "_STRAIN": "an index", "_REST": "an index", "_PARTS": "a count of indices",
        "_DEPENDENT": "tolerance of a rank",
    },
    "base/model.py": {
        "_BASE_STEP": "step of a difference quotient", "_TOLERANCE": "of a solve", "_FRICTION_PASSES": "of a solve",
    },
    "light/image_formation.py": {"_TINY": "keeps a logarithm finite"},
    "light/patches.py": {
        "HALF": "size of an array", "_MARGIN": "size of an array", "_SPACING": "of a grid",
        "_NEIGHBOURS": "size of an array", "_GAMMA": "of displays",
    },
}  # fmt: skip
FOLDERS = {"effects": "the form of an effect, as its doses are", "page": "sizes of drawings"}


def numbers_of(path):
    """Names of upper-case constants at the top of a module that hold numbers and nothing else but names of numbers."""
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
            continue
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        names = [node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)]
        held = [node.value for node in ast.walk(statement.value) if isinstance(node, ast.Constant)]
        if any(isinstance(v, int | float) and not isinstance(v, bool) for v in held):
            yield from (name for name in names if name == name.upper())


def test_no_number_that_decides_stands_elsewhere():
    found = {}
    for path in sorted(GAP.rglob("*.py")):
        place = path.relative_to(GAP).as_posix()
        if path.name != "thresholds.py" and place.split("/")[0] not in FOLDERS:
            found |= {place: names} if (names := set(numbers_of(path))) else {}
    assert found == {place: set(names) for place, names in ELSEWHERE.items()}


def test_a_number_elsewhere_is_found(tmp_path):
    module = tmp_path / "module.py"
    module.write_text("_LIMIT = 0.5\n_A, _B = 1, (2.0, 3.0)\n_NAMES = ('a', 'b')\nmixed = 3\n_ON: bool = True\n")
    assert list(numbers_of(module)) == ["_LIMIT", "_A", "_B"]


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: type(group).__name__)
def test_each_number_is_frozen_and_has_a_unit_and_a_reason(group):
    for one in fields(group):
        assert one.metadata["reason"], one.name
        assert isinstance(one.metadata["unit"], str), one.name
        with pytest.raises(AttributeError):
            setattr(group, one.name, 0)


def test_all_groups_go_into_the_report_and_the_docs():
    told = json.loads(json.dumps(thresholds_json()))
    assert len(told) == len(GROUPS) and told["verdict"]["clear"] == VERDICT.clear
    assert sum(map(len, told.values())) == sum(len(fields(group)) for group in GROUPS)
    assert "| verdict | `clear` | 4.0 | nats | a gain that names an effect |" in thresholds_table()
