"""Names of result files: readable, safe on any file system, unique and stable between runs."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping

from inference.sources import ClipSource

_UNSAFE = re.compile(r"[^\w.+-]+", re.UNICODE)
_MAX_BYTES = 120  # leaves room for suffixes below the 255 bytes that file systems allow


def assign_names(sources: Iterable[ClipSource], taken: Mapping[str, str]) -> dict[str, str]:
    """Return one result name per source key; a name in `taken` (key → name, from earlier runs) is kept.

    `sub/clip.mp4` becomes `sub__clip`; if two clips have the same name, the later one gets a digest of its path.
    """
    names = dict(taken)
    used = {name.casefold() for name in names.values()}
    for source in sources:
        if source.key in names:
            continue
        name = _readable(source)
        if name.casefold() in used:
            name = f"{name}-{_digest(source)}"
        names[source.key] = name
        used.add(name.casefold())
    return names


def _readable(source: ClipSource) -> str:
    name = _UNSAFE.sub("_", source.title.replace("/", "__")).strip("._") or "clip"
    if len(name.encode("utf-8", "replace")) <= _MAX_BYTES:
        return name
    short = name.encode("utf-8", "replace")[:_MAX_BYTES].decode("utf-8", "ignore")
    return f"{short}-{_digest(source)}"


def _digest(source: ClipSource) -> str:
    return hashlib.sha256(source.key.encode()).hexdigest()[:10]
