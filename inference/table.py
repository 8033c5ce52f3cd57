"""The table of predictions: one row per clip, written as CSV and Parquet."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from inference.prediction import PREDICTION_UNITS, Prediction

if TYPE_CHECKING:
    from pyarrow import Schema


@dataclass(frozen=True, kw_only=True)
class ResultRow:
    """One clip in the table; numbers are None in case of an error."""

    path: str
    youngs_modulus: float | None = None  # [Pa]
    poisson_ratio: float | None = None
    log10_youngs_modulus_std: float | None = None  # [decades]
    poisson_ratio_std: float | None = None
    error: str = ""  # empty = fine
    youngs_modulus_low: float | None = None  # 90 % interval [Pa]
    youngs_modulus_high: float | None = None  # [Pa]
    poisson_ratio_low: float | None = None
    poisson_ratio_high: float | None = None
    fps: float | None = None  # [1/s]
    density: float | None = None  # [kg/m³]
    object_size: float | None = None  # [m]
    foreground: str = ""
    foreground_confidence: float | None = None
    frames_used: int | None = None
    assumed: str = ""  # joined by "; "
    warnings: str = ""  # joined by "; "
    name: str = ""  # of the files in clips/
    truncated: str = ""  # names a truncated file and states the decoded part; empty: complete

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> ResultRow:
        """Build a row from values by name; those of other names are dropped, such as columns of other versions."""
        known = {field.name for field in fields(cls)}
        return cls(**{key: value for key, value in values.items() if key in known})


def row_of_prediction(name: str, prediction: Prediction) -> ResultRow:
    """Return the row of a prediction."""
    values: dict[str, Any] = vars(prediction) | {"name": name, "path": prediction.path or ""}
    for of in ("youngs_modulus", "poisson_ratio"):
        values[f"{of}_low"], values[f"{of}_high"] = values[f"{of}_interval"]
    for of in ("assumed", "warnings"):
        values[of] = "; ".join(values[of])
    return ResultRow.from_values(values)


def row_of_error(name: str, path: str, error: str) -> ResultRow:
    """Return the row of a clip without prediction."""
    return ResultRow(path=path, error=" ".join(error.split()), name=name)


def write_csv(file: TextIO, rows: Iterable[ResultRow], *, header: bool) -> None:
    """Append rows to an open text file (opened with newline=""); floats keep all their digits."""
    writer = csv.writer(file, lineterminator="\n")
    if header:
        writer.writerow([field.name for field in fields(ResultRow)])
    for row in rows:
        writer.writerow(["" if value is None else value for value in asdict(row).values()])


def write_parquet(path: Path, rows: Iterable[ResultRow]) -> None:
    """Write rows with typed columns; units are in the columns' metadata."""
    from pyarrow import Table, array, parquet  # slow to load

    rows = list(rows)
    columns = [array([getattr(row, field.name) for row in rows], type=field.type) for field in _schema()]
    parquet.write_table(Table.from_arrays(columns, schema=_schema()), path)


def _schema() -> Schema:
    import pyarrow

    kinds = {"float | None": pyarrow.float64(), "int | None": pyarrow.int64(), "str": pyarrow.string()}
    return pyarrow.schema(
        [pyarrow.field(field.name, kinds[str(field.type)], metadata=_unit(field.name)) for field in fields(ResultRow)]
    )


def _unit(name: str) -> dict[str, str] | None:
    unit = PREDICTION_UNITS.get(name) or PREDICTION_UNITS.get(name.rsplit("_", 1)[0])
    return None if unit is None else {"unit": unit}
