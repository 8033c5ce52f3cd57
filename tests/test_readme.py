"""The pages for readers name only files, commands and Python that exist."""

import re
from pathlib import Path

import pytest

from physconvex import cli

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
GENERATED = re.compile(r"(.*/)?(command_line|modules|notebook|api/[\w.]+)\.md")  # by docs/hooks.py


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_lead_to_files(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    local = [target for target in targets if "://" not in target and not target.startswith("mailto:")]
    missing = [target for target in local if not (page.parent / target).exists()]
    assert not [target for target in missing if not GENERATED.fullmatch(target)]


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_commands_exist(page: Path) -> None:
    blocks = re.findall(r"```(?:bash|sh|console)\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [line.removeprefix("$ ").split() for block in blocks for line in block.splitlines() if line.strip()]
    scripts = {words[0] for words in lines if words[0].startswith("./")}
    assert not [script for script in scripts if not (ROOT / script).exists()]
    named = {words[1] for words in lines if words[0] == "physconvex" and not words[1].startswith("-")}
    assert named <= set(cli._commands())
    targets = {words[1] for words in lines if words[0] == "make" and len(words) > 1}
    assert targets <= set(
        re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    )


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_python_blocks_compile(page: Path) -> None:
    for block in re.findall(r"```(?:python|py)\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL):
        compile(block, _name(page), "exec")


def test_readme_names_every_command() -> None:
    table = (ROOT / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `physconvex ([\w-]+)", table, flags=re.MULTILINE)) == set(cli._commands())


def test_lock_pins_everything_by_hash_from_no_particular_place() -> None:
    """Wherever the packages come from, they are these; the file names no index and no path."""
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    pinned = re.findall(r"^[\w.-]+==[^\n]*\\\n    --hash=sha256:", lock, flags=re.MULTILINE)
    assert len(pinned) == len(re.findall(r"^\w", lock, flags=re.MULTILINE)) > 100
    assert not re.search(r"://|^-|file:", lock, flags=re.MULTILINE)
