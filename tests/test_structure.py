"""The structure of the code, counted: what makes it hard to enter must not come back."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("physconvex", "models", "data_gen", "train", "inference")


@cache
def modules() -> dict[Path, ast.Module]:
    return {path: ast.parse(path.read_text()) for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))}


def functions() -> Iterator[tuple[Path, ast.FunctionDef]]:
    for path, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                yield path, node


def positional(function: ast.FunctionDef) -> list[str]:
    given = (*function.args.posonlyargs, *function.args.args)
    return [argument.arg for argument in given if argument.arg not in ("self", "cls")]


def told(path: Path, name: str) -> str:
    return f"{path.relative_to(ROOT)}: {name}"


def test_few_files_lie_at_the_top() -> None:
    loose = [path.name for path in (ROOT / "physconvex").glob("*.py")]
    assert len(loose) <= 6, loose


def test_few_functions_take_more_than_five_positional_arguments() -> None:
    many = [told(path, node.name) for path, node in functions() if len(positional(node)) > 5]
    assert len(many) <= 20, many


def test_few_functions_return_anything() -> None:
    anything = [told(p, f.name) for p, f in functions() if f.returns and re.search(r"\bAny\b", ast.unparse(f.returns))]
    assert len(anything) <= 30, anything


def test_no_public_name_is_defined_twice() -> None:
    places = defaultdict(list)
    for path, tree in modules().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(told(path, node.name))
    assert not {name: found for name, found in places.items() if len(found) > 1}


def face(path: Path) -> str:
    """Import path of the package through which others use a file's names."""
    parts = path.relative_to(ROOT).parts
    return ".".join(parts[:2]) if parts[0] == "physconvex" and len(parts) > 2 else parts[0]


def test_packages_are_imported_through_their_faces() -> None:
    around = []
    for path, tree in modules().items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.ImportFrom) or not node.module or node.module.split(".")[0] not in PACKAGES:
                continue
            source = ROOT.joinpath(*node.module.split("."))
            source = source / "__init__.py" if source.is_dir() else source.with_suffix(".py")
            loose = face(source) == "physconvex" and face(path).startswith("physconvex")
            if face(source) != face(path) and node.module != face(source) and not loose:
                around.append(told(path, node.module))
    assert not around


def test_a_face_has_no_name_of_a_submodule() -> None:
    for stub in (path for name in PACKAGES for path in (ROOT / name).rglob("__init__.pyi")):
        public = {alias.asname for node in ast.parse(stub.read_text()).body for alias in getattr(node, "names", ())}
        inside = {path.stem for path in stub.parent.iterdir() if path.suffix == ".py" or path.is_dir()}
        assert not public & inside, stub
