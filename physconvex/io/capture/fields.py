"""Read validated values from a JSON object; each error names the file, the field, what came and the remedy."""

import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from physconvex.errors import InputError

__all__ = ["JsonFields", "read_json_object"]


@dataclass(frozen=True)
class JsonFields:
    """One JSON object of a file."""

    path: Path
    values: Mapping[str, Any]
    prefix: str = ""  # of nested objects, such as "floor."

    def error(self, key: str, expected: str) -> InputError:
        """What is wrong with a field."""
        got = repr(self.values[key]) if key in self.values else "nothing"
        return InputError(f"{self.path}: {self.prefix}{key}: got {got[:80]}, expected {expected}")

    def check_names(self, known: Iterable[str]) -> None:
        """Refuse names that look like misspelt known ones; other unknown names are left alone."""
        known = list(known)
        for key in self.values:
            close = [] if key in known else difflib.get_close_matches(key, known, n=1, cutoff=0.8)
            if close:
                raise InputError(f"{self.path}: {self.prefix}{key}: unknown field; did you mean {close[0]!r}?")

    def number(self, key: str, *, default: float | None = None, positive: bool = False) -> float:
        """A finite number; `positive` excludes zero, else the sign is free."""
        if key not in self.values and default is not None:
            return default
        value = self.values.get(key)
        expected = "a positive number" if positive else "a number"
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise self.error(key, expected)
        if positive and value <= 0:
            raise self.error(key, expected)
        return float(value)

    def count(self, key: str, *, default: int | None = None, at_least: int = 1) -> int:
        """A whole number."""
        if key not in self.values and default is not None:
            return default
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < at_least:
            raise self.error(key, f"a whole number of at least {at_least}")
        return value

    def vector(self, key: str) -> Float64[np.ndarray, " 3"] | None:
        """Three finite numbers, or None if the field is absent."""
        if key not in self.values:
            return None
        try:
            vector = np.array(self.values[key], dtype=np.float64)
        except (TypeError, ValueError):
            raise self.error(key, "three numbers") from None
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise self.error(key, "three numbers")
        return vector

    def object(self, key: str) -> "JsonFields | None":
        """A nested object, or None if the field is absent or null."""
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(key, "an object")
        return JsonFields(self.path, value, f"{self.prefix}{key}.")


def read_json_object(path: Path) -> JsonFields:
    """The one object that a JSON file holds.

    Raises:
        InputError: no such file, unreadable, not JSON, or not an object.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected a folder with {path.name}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check its permissions") from None
    except ValueError as error:  # JSON or UTF-8
        raise InputError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds a {type(values).__name__}, expected a JSON object")
    return JsonFields(path, values)
