"""What the pages show is so: every command line parses, every name exists, and the code of the tutorials runs."""

import ast
import importlib
import json
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import trimesh
import typer

from docs.schemas import schemas
from physconvex import cli

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")])
CURRENT = [page for page in PAGES if page.name != "CHANGELOG.md"]
PACKAGES = "physconvex|models|data_gen|train|inference"
GROUPS = {"physconvex.commands", "physconvex.evaluations"}  # of entry points


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def _blocks(page: Path, kinds: str) -> list[str]:
    return re.findall(rf"^```(?:{kinds})\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def _command_lines(page: Path) -> Iterator[list[str]]:
    for block in _blocks(page, "bash|sh|console"):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line.removeprefix("$ "), comments=True)
            ends = [k for k, word in enumerate(words) if word in ("|", ">", "&&", ";", "&")]
            yield words[: ends[0]] if ends else words


@cache
def _command(name: str) -> typer.core.TyperCommand:
    return cli._load(cli._commands()[name])


def _parse(command: object, words: list[str]) -> None:
    """Fails where the command's parser does; nothing runs."""
    inner = getattr(command, "commands", {})
    if inner and words and words[0] in inner:
        _parse(inner[words[0]], words[1:])
    elif "--help" not in words:
        command.make_context("physconvex", list(words))


@pytest.mark.parametrize("page", CURRENT, ids=_name)
def test_command_lines_parse(page: Path) -> None:
    for words in _command_lines(page):
        if words[:1] == ["physconvex"] and len(words) > 1 and not words[1].startswith("-"):
            _parse(_command(words[1]), words[2:])


@pytest.mark.parametrize("page", CURRENT, ids=_name)
def test_pages_are_short_and_wrapped(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    assert len(re.findall(r"[^\W_][\w’'.-]*", prose)) <= 1500
    assert not [line for line in prose.splitlines() if len(line) > 120 and not line.startswith("|")]
    assert not re.findall(r"(?<![\w.\d/])\.\d+\b", prose)  # numbers have a leading zero


@pytest.mark.parametrize("page", CURRENT, ids=_name)
def test_scripts_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    files = re.findall(r"\bpython ([\w/]+\.py)", text) + re.findall(r"\b(tests/[\w/]+\.py)", text)
    modules = [name.replace(".", "/") + ".py" for name in re.findall(r"\bpython -m (docs[\w.]+)", text)]
    assert not [name for name in [*files, *modules] if not (ROOT / name).exists()]


def _exists(name: str) -> bool:
    """Whether a dotted name can be imported, or is an attribute or a field of what can."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        return _has(found, parts[k:])
    return False


def _has(owner: object, names: list[str]) -> bool:
    if not names:
        return True
    if hasattr(owner, names[0]):
        return _has(getattr(owner, names[0]), names[1:])
    fields = getattr(owner, "model_fields", {}) or getattr(owner, "__dataclass_fields__", {})
    return len(names) == 1 and names[0] in {*fields, *getattr(owner, "__annotations__", {})}


@pytest.mark.parametrize("page", CURRENT, ids=_name)
def test_dotted_names_exist(page: Path) -> None:
    spans = re.findall(rf"`((?:{PACKAGES})(?:\.\w+)+)(?:\(.*?\))?`", page.read_text(encoding="utf-8"))
    assert not [name for name in sorted(set(spans) - GROUPS) if not _exists(name)]


@pytest.mark.parametrize("page", CURRENT, ids=_name)
def test_imports_exist(page: Path) -> None:
    wanted = [
        f"{node.module}.{alias.name}"
        for block in _blocks(page, "python|py")
        for node in ast.walk(ast.parse(block))
        if isinstance(node, ast.ImportFrom) and re.fullmatch(rf"({PACKAGES})(\.\w+)*", node.module or "")
        for alias in node.names
    ]
    assert not [name for name in wanted if not _exists(name)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", ["tutorials/predict", "tutorials/refine", "tutorials/diagnose", "howto/own_capture", "howto/simulate",
             "howto/extend", "reference/prediction_files"]
)  # fmt: skip
def test_code_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The Python blocks of a page one after the other, in a folder that has `examples`."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "page", "out": tmp_path}
    if page == "howto/simulate":
        names["mesh_file"] = tmp_path / "box.obj"
        trimesh.creation.box(extents=(0.2, 0.1, 0.1)).export(names["mesh_file"])
    if page == "reference/prediction_files":
        names["results"] = _predicted(tmp_path)
    for block in _blocks(ROOT / "docs" / f"{page}.md", "python"):
        exec(compile(block, page, "exec"), names)
    for name, made in (("refinement", "found"), ("report", "report")):
        if made in names:
            record = json.loads(json.dumps(names[made].to_json()))  # type: ignore[attr-defined]
            assert not list(_misfits(record, schemas()[name], name))
    if page == "reference/prediction_files":
        record = json.loads((tmp_path / "results/clips/kong.json").read_text(encoding="utf-8"))
        assert not list(_misfits(record, schemas()["prediction"], "prediction"))


def _predicted(folder: Path) -> Path:
    from inference import predict_batch

    predict_batch("examples/clips/kong.mp4", out=folder / "results", density=1000.0, object_size=1.0)
    return folder / "results"


def _misfits(value: object, schema: dict[str, Any], place: str) -> Iterator[str]:
    """Where a JSON value is not as a schema says, as far as docs/reference/schemas.yml goes."""
    kinds = {"object": dict, "array": list, "string": str, "number": (int, float), "integer": int, "boolean": bool}
    named = schema.get("type", [])
    wanted = [named] if isinstance(named, str) else named
    if wanted and not any(value is None if kind == "null" else isinstance(value, kinds[kind]) for kind in wanted):
        yield f"{place}: {value!r} is no {' or '.join(wanted)}"
    if value != schema.get("const", value) or value not in schema.get("enum", [value]):
        yield f"{place}: {value!r}"
    if isinstance(value, dict):
        yield from (f"{place}.{name}: missing" for name in schema.get("required", ()) if name not in value)
        for name, inner in value.items():
            each = schema.get("properties", {}).get(name, schema.get("additionalProperties", {}))
            yield from _misfits(inner, each, f"{place}.{name}")
    if isinstance(value, list):
        yield from (text for item in value for text in _misfits(item, schema.get("items", {}), f"{place}[]"))


@pytest.mark.parametrize("beam", ["gravity", "load101"])
def test_stored_reports_are_as_their_schema_says(beam: str) -> None:
    report = json.loads((ROOT / f"benchmarks/results/gap_silicone_beam_{beam}.json").read_text(encoding="utf-8"))
    assert not list(_misfits(report, schemas()["report"], "report"))
    del report["which"]["verdict"]
    report["how_far"]["gap_before"] = "much"
    assert len(list(_misfits(report, schemas()["report"], "report"))) == 2


def test_cells_of_the_notebook_are_those_of_the_tutorials() -> None:
    """The tutorials' code is run above; here nothing has to be."""
    tutorials = [block for page in (ROOT / "docs" / "tutorials").glob("*.md") for block in _blocks(page, "python")]
    notebook = json.loads((ROOT / "examples" / "first_steps.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(cells) == 6 and all(cell["outputs"] for cell in cells)
    assert {cell["source"] for cell in cells} <= {block.rstrip() for block in tutorials}
