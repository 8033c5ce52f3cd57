"""Each benchmark, stored result and figure belongs to a page: a number stands beside what prints it."""

import ast
import importlib
import re
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = "\n".join(path.read_text(encoding="utf-8") for path in [*ROOT.glob("README.md"), *DOCS.rglob("*.md")])
PACKAGES = ("physconvex", "models", "data_gen", "train", "inference")
SCRIPTS = {path.stem: path for path in (ROOT / "benchmarks").glob("*.py")}
IMPORTED = {
    name
    for path in SCRIPTS.values()
    for name in re.findall(r"^from (\w+) import", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
}


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_a_benchmark_is_named_by_a_page_or_serves_another(name: str) -> None:
    assert f"benchmarks/{name}.py" in PAGES or name in IMPORTED


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks" / "results").iterdir()), ids=lambda path: path.name)
def test_a_stored_result_is_named_by_a_page(path: Path) -> None:
    assert path.name in PAGES


def test_what_pages_run_exists() -> None:
    named = set(re.findall(r"\b(?:benchmarks|docs/figures)/\w+\.py", PAGES))
    named |= {f"docs/figures/{name}.py" for name in re.findall(r"-m docs\.figures\.(\w+)", PAGES)}
    assert not [name for name in named if not (ROOT / name).is_file()]


def test_pictures_and_data_are_shown() -> None:
    files = chain((DOCS / "images").iterdir(), (DOCS / "results" / "data").iterdir())
    assert not [path.name for path in files if path.name not in PAGES]


@pytest.mark.parametrize("path", [*SCRIPTS.values(), *DOCS.glob("figures/**/*.py")], ids=lambda path: path.stem)
def test_what_a_script_imports_exists(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES:
            module = importlib.import_module(str(node.module))
            missing = [alias.name for alias in node.names if not hasattr(module, alias.name)]
            assert not [name for name in missing if find_spec(f"{node.module}.{name}") is None]
