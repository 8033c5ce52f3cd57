"""What `mkdocs build` makes itself: pages of the API and the command line, and links to files outside `docs/`."""

from __future__ import annotations

import ast
import json
import posixpath
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import physconvex
from docs.schemas import plain, schema_table, schemas
from physconvex import cli

ROOT = Path(__file__).resolve().parent.parent
FACES = (
    "physconvex",
    "inference",
    "physconvex.identify",
    "physconvex.gap",
    "physconvex.reduced",
    "physconvex.fem",
    "physconvex.mesh",
    "physconvex.materials",
    "physconvex.dynamics",
    "physconvex.convex",
    "physconvex.render",
    "physconvex.reconstruction",
    "physconvex.play",
    "physconvex.io",
    "physconvex.numerics",
    "physconvex.kernels",
    "models",
    "data_gen",
    "train",
)
OUTSIDE = {
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
    "examples/captures.md": "examples/captures/README.md",
    "examples/clips.md": "examples/clips/README.md",
}
_SCHEMA = re.compile(r"<!-- schema: (\w+) -->")
_NAME = re.compile(r"(?<!\[)`((?:physconvex|models|data_gen|train|inference)(?:\.\w+)+)`")
_LINK = re.compile(r"(!?\[[^\]]*\]\()([^)#\s]+)")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Adds the generated pages, the pages that lie elsewhere, and the files that pages link to."""
    for face in FACES:
        files.append(File.generated(config, f"reference/api/{face}.md", content=api_page(face)))
    files.append(File.generated(config, "reference/command_line.md", content=command_line_page()))
    files.append(File.generated(config, "reference/modules.md", content=modules_page()))
    files.append(File.generated(config, "tutorials/notebook.md", content=notebook_page()))
    for name, schema in schemas().items():
        text = json.dumps(schema, indent=1, ensure_ascii=False)
        files.append(File.generated(config, f"reference/{name}.schema.json", content=text))
    for uri, source in OUTSIDE.items():
        files.append(File.generated(config, uri, abs_src_path=str(ROOT / source)))
    for target in sorted(_linked_files(files)):
        files.append(File.generated(config, f"repository/{target}", abs_src_path=str(ROOT / target)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links are written for a reader of the repository; in the site they lead to the same files."""
    markdown = _SCHEMA.sub(lambda match: schema_table(match[1]), markdown)
    source = _in_repository(page.file.src_uri)

    def moved(match: re.Match[str]) -> str:
        target = _target(source, match[2])
        if target is None:
            return match[0]
        return match[1] + posixpath.relpath(_in_site(target), posixpath.dirname(page.file.src_uri) or ".")

    if page.file.generated_by and page.file.src_uri not in OUTSIDE:
        return markdown
    return _NAME.sub(_linked_name, _LINK.sub(moved, markdown))


def _linked_name(match: re.Match[str]) -> str:
    """A public name in a page leads to its place in the reference."""
    name = _shortcuts().get(match[1].removeprefix("physconvex."), match[1])
    return f"[`{match[1]}`][{name}]" if name in _documented() else match[0]


@cache
def _shortcuts() -> dict[str, str]:
    """The names of `physconvex` itself, and where each is documented."""
    found = {}
    for name in set(physconvex.__all__) - {"__version__"}:
        value = getattr(physconvex, name)
        module, there = value.__module__, value.__name__
        faces = [face for face in FACES[1:] if module.startswith(f"{face}.") and f"{face}.{there}" in _documented()]
        found[name] = f"{faces[0]}.{there}" if faces else f"{module}.{there}"
    return found


@cache
def _documented() -> frozenset[str]:
    faces = {face: public_names(ROOT / face.replace(".", "/")) for face in FACES}
    return frozenset(
        f"{face}.{name}" for face, modules in faces.items() for names in modules.values() for name in names
    )


def _linked_files(files: Files) -> Iterator[str]:
    for file in files.documentation_pages():
        if file.generated_by and file.src_uri not in OUTSIDE:
            continue
        source = _in_repository(file.src_uri)
        for match in _LINK.finditer((ROOT / source).read_text(encoding="utf-8")):
            target = _target(source, match[2])
            if target and _in_site(target).startswith("repository/"):
                yield target


def _target(source: str, link: str) -> str | None:
    """The file of the repository that a link leads to; `None` for links to elsewhere."""
    target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
    return None if ":" in link or target.startswith("..") or not (ROOT / target).is_file() else target


def _in_repository(uri: str) -> str:
    return OUTSIDE.get(uri, f"docs/{uri}")


def _in_site(target: str) -> str:
    elsewhere = {source: uri for uri, source in OUTSIDE.items()}
    if target.startswith("docs/") and not target.startswith("docs/figures/"):
        return target.removeprefix("docs/")
    return elsewhere.get(target, f"repository/{target}")


def api_page(face: str) -> str:
    """The public names of a package, under the modules that define them."""
    folder = ROOT / face.replace(".", "/")
    lines = [f"# `{face}`", "", _docstring(folder / "__init__.py"), ""]
    if face == "physconvex":
        rows = [f"| `physconvex.{name}` | [`{place}`][{place}] |" for name, place in sorted(_shortcuts().items())]
        own = [f"\n::: {place}" for place in sorted(_shortcuts().values()) if place not in _documented()]
        return "\n".join([*lines, "| name | is |", "|---|---|", *rows, *own])
    for module, names in public_names(folder).items():
        path = folder / f"{module.replace('.', '/')}.py"
        title = _docstring(path if path.exists() else path.with_suffix("") / "__init__.py").split("\n\n")[0]
        lines += [f"## {module}", "", title, ""]
        lines += [f"::: {face}.{name}\n" for name in names]
    return "\n".join(lines)


def public_names(folder: Path) -> dict[str, list[str]]:
    """Names that the stub of a package lists, by the module that each comes from."""
    stub = folder / "__init__.pyi"
    found: dict[str, list[str]] = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body if stub.exists() else ():
        if isinstance(node, ast.ImportFrom):
            found.setdefault(node.module or "", []).extend(alias.asname or alias.name for alias in node.names)
    return found


def modules_page() -> str:
    """Every module with the first line of its docstring."""
    lines = ["# All modules", ""]
    for package in dict.fromkeys(face.split(".")[0] for face in FACES):
        for folder in sorted({path.parent for path in (ROOT / package).rglob("*.py")}):
            name = str(folder.relative_to(ROOT)).replace("/", ".")
            lines += [
                f"## {name}",
                "",
                _docstring(folder / "__init__.py").split("\n\n")[0],
                "",
                "| module | |",
                "|---|---|",
            ]
            modules = sorted(path for path in folder.glob("*.py") if path.name != "__init__.py")
            lines += [f"| `{path.stem}` | {plain(_docstring(path).split(chr(10) * 2)[0])} |" for path in modules]
            lines.append("")
    return "\n".join(lines)


def _docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def notebook_page() -> str:
    """The cells of the notebook with what they print and draw."""
    lines: list[str] = []
    for cell in json.loads((ROOT / "examples" / "first_steps.ipynb").read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "markdown":
            lines += [cell["source"], ""]
            continue
        lines += ["```python", cell["source"], "```", ""]
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "text" in output:
                lines += ["```text", output["text"].rstrip(), "```", ""]
            elif "image/png" in data:
                lines += [f'<img alt="figure" src="data:image/png;base64,{data["image/png"]}">', ""]
            elif "text/html" in data:
                lines += ["<div>" + re.sub(r"\s*\n\s*", " ", data["text/html"]) + "</div>", ""]
    return "\n".join(lines)


def command_line_page() -> str:
    """Every command with its arguments and options, as typer knows them."""
    lines = [
        "# Command line",
        "",
        "`physconvex COMMAND --help` shows the same. Exit code 0: all is done. 1: some inputs fail; each is named, and",
        "the others are done. 2: wrong usage or unusable input.",
        "",
    ]
    for name, point in cli._commands().items():
        lines += _command(f"physconvex {name}", cli._load(point))
    return "\n".join(lines)


def _command(path: str, command: Any, level: int = 2) -> Iterator[str]:
    yield f"{'#' * level} {path}\n\n{plain(command.help)}\n"
    inner = getattr(command, "commands", {})
    for name, each in inner.items():
        yield from _command(f"{path} {name}", each, level + 1)
    if inner:
        return
    context = typer.Context(command)
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and "--help" not in p.opts]
    yield f"```text\n{path} {' '.join(command.collect_usage_pieces(context))}\n```\n"
    if arguments:
        yield "| argument | |\n|---|---|"
        yield from (f"| `{p.name}` | {plain(p.help)} |" for p in arguments)
        yield ""
    yield "| option | value | default | |\n|---|---|---|---|"
    yield from (f"| {_flags(p)} | {_value(p, context)} | {_default(p)} | {plain(p.help)} |" for p in options)
    yield ""


def _flags(option: Any) -> str:
    return ", ".join(f"`{name}`" for name in [*option.opts, *option.secondary_opts])


def _value(option: Any, context: typer.Context) -> str:
    if option.is_flag:
        return ""
    kind = re.sub(r"list\[(\w+)\]| range", r"\1", option.display_type(context).strip("<>"))
    kind = {"Path": "path", "str": "text"}.get(kind, kind)
    return ", ".join(f"`{choice}`" for choice in kind.split("|")) + (" …" if option.multiple else "")


def _default(option: Any) -> str:
    value = option.default
    if option.is_flag:
        return "yes" if value else "no"
    if value is None or callable(value) or value in ((), []):
        return "required" if option.required else ""
    value = getattr(value, "value", value)
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
