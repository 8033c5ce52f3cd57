"""Frozen configurations read from YAML: a file or a preset, overrides of single values, plain error messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from physconvex.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


class FrozenConfig(BaseModel):
    """An immutable section of a configuration, strict about unknown names; docstrings of fields describe them."""

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


def read_tree(source: str | Path, package: str, *, argument: str, expected: str) -> dict[str, Any]:
    """The tree in a YAML file, or in the preset of that name.

    Args:
        source: path of a file, or name of a preset; a file takes precedence.
        package: package of the presets.
        argument: name of the source in errors.
        expected: expected content of a file, for errors.

    Raises:
        InputError: no such file or preset, bad YAML, or no mapping.
    """
    preset = resources.files(package) / "presets" / f"{source}.yaml"
    if Path(source).is_file():
        text = Path(source).read_text(encoding="utf-8")
    elif "/" not in str(source) and preset.is_file():
        text = preset.read_text(encoding="utf-8")
    else:
        names = ", ".join(preset_names(package))
        raise InputError(f"{argument}: got {str(source)!r}; expected a YAML file or one of the presets {names}")
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


def validated(model: type[Model], tree: Mapping[str, Any], *, argument: str) -> Model:
    """The configuration, or an error that lists every wrong place.

    Raises:
        InputError: an unknown name or a value out of range.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        lines = (f"{'.'.join(str(part) for part in e['loc'])}: {e['msg']} (got {e['input']!r})" for e in error.errors())
        raise InputError(f"{argument}: " + "; ".join(lines)) from error
