"""JSON Schemas of capture.json and of the result files, and their fields as tables."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from physconvex.io import capture_schema

STATED = Path(__file__).resolve().parent / "reference" / "schemas.yml"


@cache
def schemas() -> dict[str, dict[str, Any]]:
    """JSON Schemas by name: of the capture by its model, of results by `docs/reference/schemas.yml`."""
    stated = yaml.safe_load(STATED.read_text(encoding="utf-8"))
    return {"capture": capture_schema()} | {name: _schema(name, fields) for name, fields in stated.items()}


def _schema(title: str, fields: dict[str, Any]) -> dict[str, Any]:
    properties, required = {}, []
    for key, value in fields.items():
        name, _, each = key.removesuffix("?").partition(".")
        inner = value if {"type", "const", "enum"} & set(value) else _schema("", value)
        properties[name] = {"type": "object", "additionalProperties": inner} if each else inner
        required += [] if key.endswith("?") else [name]
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title} if title else {}
    return {**head, "type": "object", "properties": properties, "required": required}


def schema_table(name: str) -> str:
    """The fields of a JSON Schema as a table, and a link to the schema itself."""
    schema = schemas()[name]
    note = "default" if name == "capture" else "unit"
    rows = list(_rows(schema, schema.get("$defs", {}), "", note))
    lines = [f"JSON Schema: [{name}.schema.json]({name}.schema.json).", "", f"| field | type | {note} | meaning |"]
    return "\n".join([*lines, "|---|---|---|---|", *rows])


def _rows(schema: dict[str, Any], known: dict[str, Any], path: str, note: str) -> Iterator[str]:
    for name, field in schema["properties"].items():
        inner, place = _resolved(field, known), f"{path}{name}"
        each, items = inner.get("additionalProperties"), inner.get("items")
        if "description" in field or not ("properties" in inner or isinstance(each, dict)):
            said = field.get("unit", "") if note == "unit" else _stated(field, name in schema.get("required", ()))
            meaning = plain(field.get("description", inner.get("description")))
            yield f"| `{place}` | {_kind(inner)} | {said} | {meaning} |"
        for part, ending in ((inner, "."), (each, ".NAME."), (items, "[].")):
            part = _resolved(part, known) if isinstance(part, dict) else {}
            if "properties" in part:
                yield from _rows(part, known, place + ending, note)


def _stated(field: dict[str, Any], required: bool) -> str:
    if required:
        return "required"
    return "" if field.get("default") in (None, [], ()) else f"`{json.dumps(field['default'])}`"


def _resolved(field: dict[str, Any], known: dict[str, Any]) -> dict[str, Any]:
    """A field without references, and without null among its choices."""
    choices = [choice for choice in field.get("anyOf", ()) if choice.get("type") != "null"]
    field = choices[0] if choices else field
    return known[field["$ref"].rsplit("/", 1)[-1]] if "$ref" in field else field


def _kind(field: dict[str, Any]) -> str:
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    kind = field.get("type", "")
    name = " or ".join(kind) if isinstance(kind, list) else str(kind)
    return f"{name} of {field['minItems']}" if "minItems" in field else name


def plain(text: str | None) -> str:
    """On one line, for a cell of a table."""
    return re.sub(r"\s+", " ", (text or "").replace("\\[", "[")).replace("|", "\\|").strip()
