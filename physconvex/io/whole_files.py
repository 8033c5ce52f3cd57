"""Files that appear under their name whole or not at all, even if the process that writes them is killed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write a file, in its folder and with its suffix; it gets its name when the block ends without an error.

    Processes that write the same file do not meet: the last one wins.
    """
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_json(path: Path, content: Mapping[str, Any], *, sort_keys: bool = False, allow_nan: bool = False) -> None:
    """Write a JSON file (UTF-8), whole or not at all.

    Raises:
        ValueError: NaN or infinity, which JSON does not have, unless Python's names of them are allowed.
    """
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=allow_nan, sort_keys=sort_keys)
    with whole_file(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")
