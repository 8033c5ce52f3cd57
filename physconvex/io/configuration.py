"""Frozen configurations read from YAML: a file or a preset, overrides of single values, plain error messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from physconvex.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


class FrozenConfig(BaseModel):
    """Immutable settings, strict about unknown names; docstrings of fields describe them."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


@dataclass(frozen=True)
class Expected:
    """Expected content of a field, as metadata of its annotation, for error messages."""

    words: str


def in_words(model: type[BaseModel], field: str, values: Mapping[str, Any]) -> str:
    """The value of a field and the expected one, from the field's `Expected`."""
    expected = next(part.words for part in model.model_fields[field].metadata if isinstance(part, Expected))
    return f"got {repr(values[field])[:80] if field in values else 'nothing'}, expected {expected}"


def preset_names(package: str) -> list[str]:
    """Names of the presets in the folder `presets` of a package."""
    folder = resources.files(package) / "presets"
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def read_tree(source: str | Path, package: str | None, *, argument: str, expected: str) -> dict[str, Any]:
    """The tree in a YAML file, or in the preset of that name.

    Args:
        source: path of a file, or name of a preset; a file takes precedence.
        package: package of the presets; None: there are none.
        argument: name of the source in errors.
        expected: expected content of a file, for errors.

    Raises:
        InputError: no such file or preset, bad YAML, or no mapping.
    """
    if Path(source).is_file():
        text = Path(source).read_text(encoding="utf-8")
    elif package is None:
        raise InputError(f"{argument}: {source} is not a file; expected YAML with {expected}")
    elif str(source) in (names := preset_names(package)):
        text = (resources.files(package) / "presets" / f"{source}.yaml").read_text(encoding="utf-8")
    else:
        raise InputError(
            f"{argument}: got {str(source)!r}; expected a YAML file or one of the presets {', '.join(names)}"
        )
    try:
        tree = yaml.safe_load(text) or {}
    except yaml.YAMLError as error:
        raise InputError(f"{argument}: {source} is no valid YAML: {error}") from error
    if not isinstance(tree, dict):
        raise InputError(f"{argument}: {source} holds {type(tree).__name__}; expected {expected}")
    return tree


def set_value(tree: dict[str, Any], override: str, *, example: str) -> None:
    """Set `section.name=value` in a tree; the value is YAML. `example` is shown in errors.

    Raises:
        InputError: another form, a section that is a value, or bad YAML.
    """
    path, equals, text = override.partition("=")
    *sections, name = path.strip().split(".")
    if not equals or not name:
        raise InputError(f"--set: got {override!r}; expected section.name=value, as {example}")
    for section in sections:
        branch = tree.setdefault(section, {})
        if not isinstance(branch, dict):
            raise InputError(f"--set: {section!r} in {override!r} is a value, not a section")
        tree = branch
    try:
        tree[name] = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(f"--set: {override!r}: the value is no valid YAML: {error}") from error


_EXPECTED = {
    "greater_than_equal": "expected at least {ge}",
    "greater_than": "expected more than {gt}",
    "less_than_equal": "expected at most {le}",
    "less_than": "expected less than {lt}",
    "literal_error": "expected one of {expected}",
    "finite_number": "expected a finite number",
}


def error_in_words(error: ValidationError) -> str:
    """Every wrong place: the name, its value, the expected value."""
    return "; ".join(map(_place_in_words, error.errors()))


def _place_in_words(place: ErrorDetails) -> str:
    name, context = ".".join(map(str, place["loc"])), place.get("ctx", {})
    if isinstance(context.get("error"), InputError):
        return str(context["error"])
    if place["type"] == "extra_forbidden":
        return f"{name}: no such option"
    expected = _EXPECTED.get(place["type"])
    told = place["msg"] if expected is None else expected.format(**context).replace("'", "").replace(" or ", ", ")
    return f"{name}: got {place['input']!r}; {told}"


def validated(model: type[Model], tree: Mapping[str, Any], *, argument: str) -> Model:
    """The configuration, or an error that lists every wrong place.

    Raises:
        InputError: an unknown name or a value out of range.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise InputError(f"{argument}: {error_in_words(error)}") from error
