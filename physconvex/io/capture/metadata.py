"""`capture.json`: one typed model that reads it, reports errors in it, and makes its JSON Schema."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, JsonValue, Strict, ValidationError
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import ErrorDetails

from physconvex.errors import InputError
from physconvex.io.camera import Camera, CameraEntry
from physconvex.io.configuration import Expected, in_words

CAPTURE_FILE = "capture.json"


_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Vector = tuple[_Finite, _Finite, _Finite]
Vector = Annotated[_Vector, Expected("three numbers")]
OptionalVector = Annotated[_Vector | SkipJsonSchema[None], Expected("three numbers")]
Positive = Annotated[float, Strict(), Field(gt=0, allow_inf_nan=False), Expected("a positive number")]
_NotNegative = Annotated[float, Strict(), Field(ge=0, allow_inf_nan=False)]
OptionalNotNegative = Annotated[_NotNegative | SkipJsonSchema[None], Expected("a number of at least 0")]
_Count = Annotated[int, Strict(), Field(ge=1)]
Count = Annotated[_Count, Expected("a whole number of at least 1")]
OptionalCount = Annotated[_Count | SkipJsonSchema[None], Expected("a whole number of at least 1")]


class _Entry(BaseModel):
    """An object of the file. Names that look like misspelt ones are refused, other unknown names are left alone."""

    model_config = ConfigDict(frozen=True, extra="ignore", use_attribute_docstrings=True)


class FloorEntry(_Entry):
    """A half-space that the body cannot enter."""

    point: Vector
    """A point of its surface [m], world frame."""
    normal: Vector
    """Direction away from the floor, of any length but zero, world frame."""
    friction: OptionalNotNegative = None
    """Coulomb's coefficient. Default: unknown."""


class CaptureFile(_Entry):
    """What was recorded of one motion of one object, in SI units, world frame with z up. Frame 0 is at t = 0."""

    fps: Positive
    """Frames per second [1/s]."""
    frames: Count
    """Number of frames."""
    observed_frames: OptionalCount = None
    """Number of first frames that may be fitted; the others test the prediction. Default: all."""
    gravity: Vector = (0.0, 0.0, -9.81)
    """Acceleration by gravity [m/s²]."""
    density: Positive = 1000.0
    """Density of the body [kg/m³]."""
    floor: Annotated[FloorEntry | None, Expected("an object")] = None
    """The floor; null or absent: there is none."""
    initial_velocity: OptionalVector = None
    """Velocity of the centre of mass at t = 0 [m/s]; absent: not known."""
    initial_angular_velocity: OptionalVector = None
    """Angular velocity at t = 0 [rad/s]; absent: not known."""
    cameras: Annotated[tuple[CameraEntry, ...], Expected("a list of objects")] = ()
    """The cameras, which stand still. `NAME.mp4` or the folder `NAME` holds the images of the camera NAME."""


def capture_schema() -> dict[str, JsonValue]:
    """The JSON Schema of `capture.json`."""
    schema: dict[str, JsonValue] = CaptureFile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def read_capture_file(path: Path) -> CaptureFile:
    """Read `capture.json`.

    Raises:
        InputError: no such file, not JSON, not an object, or a field that is missing, misspelt or wrong.
    """
    values = _read_object(path)
    floor = values.get("floor")
    _refuse_misspelt(path, values, CaptureFile, "")
    if isinstance(floor, dict):
        _refuse_misspelt(path, floor, FloorEntry, "floor.")
    try:
        return CaptureFile.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: " + "; ".join(dict.fromkeys(_in_words(error.errors(), values)))) from None


def _read_object(path: Path) -> dict[str, JsonValue]:
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
    return values


def _refuse_misspelt(path: Path, values: Mapping[str, JsonValue], model: type[_Entry], prefix: str) -> None:
    known = list(model.model_fields)
    for key in values:
        close = [] if key in known else difflib.get_close_matches(key, known, n=1, cutoff=0.8)
        if close:
            raise InputError(f"{path}: {prefix}{key}: unknown field; did you mean {close[0]!r}?")


def _in_words(errors: list[ErrorDetails], values: Mapping[str, JsonValue]) -> Iterator[str]:
    """The error: the field, its value, the expected value."""
    for error in errors:
        first, *inner = error["loc"]
        entry = values.get(str(first))
        if first == "cameras" and inner and isinstance(entry, list) and isinstance(entry[int(inner[0])], dict):
            try:
                Camera.from_json(entry[int(inner[0])])  # type: ignore[arg-type]
            except InputError as problem:
                yield str(problem)
            continue
        model: type[_Entry] = CaptureFile
        name, key, found = str(first), str(first), values
        if first == "floor" and inner and isinstance(entry, dict):
            model, name, key, found = FloorEntry, f"floor.{inner[0]}", str(inner[0]), entry
        yield f"{name}: {in_words(model, key, found)}"
