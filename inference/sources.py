"""Find clips: video files, capture folders and image folders below the given paths."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

VIDEO_EXTENSIONS = frozenset(
    ".mp4 .m4v .mov .avi .mkv .webm .mpg .mpeg .wmv .flv .ts .mts .m2ts .ogv .3gp .y4m .gif".split()
)
IMAGE_EXTENSIONS = frozenset(".png .jpg .jpeg".split())

SourceKind = Literal["video", "capture", "images"]
_NUMBERED = re.compile(r"\d$")


@dataclass(frozen=True)
class _Place:
    path: Path

    @property
    def key(self) -> str:
        """Identity between runs: the absolute path (symbolic links kept)."""
        return displayed_path(os.path.abspath(self.path))


@dataclass(frozen=True)
class ClipSource(_Place):
    """One clip to read: a video file, a capture folder or a folder of numbered images."""

    kind: SourceKind
    title: str
    """Path relative to the folder it was found in, without extension; the stem of result names."""


@dataclass(frozen=True)
class SourceProblem(_Place):
    """A path below which nothing can be read, and why."""

    cause: str


Found = ClipSource | SourceProblem


def displayed_path(path: str | os.PathLike[str]) -> str:
    r"""Return the path as text that any file can hold (bytes that are no UTF-8 become ``\xNN``)."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


def find_sources(
    paths: Iterable[str | os.PathLike[str]], *, exclude: Sequence[str | os.PathLike[str]] = ()
) -> list[Found]:
    """Return every clip at or below `paths`, each once, in a fixed order, and every path that cannot be read.

    Folders are searched recursively by video extension. A folder with `capture.json` is one clip, and so is a folder of
    numbered images (two or more). `NAME_mask.mp4` beside `NAME.mp4` is its mask, not a clip. Hidden entries and the
    folders in `exclude` are skipped. Links to folders are followed after all real folders; a link to one of its own
    parents is reported.
    """
    excluded = {os.path.realpath(path) for path in exclude}
    seen: set[str] = set()
    found: list[Found] = []
    for path in paths:
        for item in _found_at(Path(path), excluded):
            if item.key not in seen:
                seen.add(item.key)
                found.append(item)
    return found


def source_at(path: str | os.PathLike[str]) -> Found:
    """Return the one clip at `path` itself (a folder must be a capture or hold images)."""
    path = Path(path)
    problem = _unreadable(path)
    if problem is not None:
        return problem
    if not path.is_dir():
        return ClipSource(path, "video", path.stem)
    kind = _folder_kind(path, _entries(path), least_images=1)
    if kind is None:
        return SourceProblem(path, "is a folder without capture.json and without numbered images")
    return ClipSource(path, kind, path.resolve().name)


def _found_at(path: Path, excluded: set[str]) -> Iterator[Found]:
    problem = _unreadable(path)
    if problem is None and path.is_dir():
        yield from _walk(path, excluded)
    else:
        yield problem or ClipSource(path, "video", path.stem)


def _unreadable(path: Path) -> SourceProblem | None:
    try:
        os.stat(path)
    except FileNotFoundError:
        cause = "is a link to a file that is not there" if path.is_symlink() else "does not exist"
        return SourceProblem(path, cause)
    except OSError as error:
        return SourceProblem(path, _os_cause(error))
    return None


def _os_cause(error: OSError) -> str:
    if error.errno is not None and "symbolic links" in os.strerror(error.errno):
        return "symbolic link loop"
    if isinstance(error, PermissionError):
        return "no permission to read it"
    return f"cannot be read ({error.strerror or error})"


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        return sorted(entries, key=lambda entry: entry.name)


def _folder_kind(
    folder: Path, entries: list[os.DirEntry[str]], *, least_images: int = 2
) -> Literal["capture", "images"] | None:
    if any(entry.name == "capture.json" for entry in entries):
        return "capture"
    files = [Path(entry.name) for entry in entries if not entry.name.startswith(".")]
    if any(name.suffix.lower() in VIDEO_EXTENSIONS for name in files):
        return None
    images = [name for name in files if name.suffix.lower() in IMAGE_EXTENSIONS]
    numbered = [name for name in images if _NUMBERED.search(name.stem)]
    return "images" if len(numbered) >= least_images else None


def _walk(root: Path, excluded: set[str]) -> Iterator[Found]:
    """Walk real folders first, then linked ones, each real folder once."""
    pending, linked = [root], list[Path]()
    visited: set[str] = set()
    while pending or linked:
        if pending:
            folder = pending.pop()
        else:
            folder = linked.pop(0)
            if Path(os.path.realpath(folder.parent)).is_relative_to(os.path.realpath(folder)):
                yield SourceProblem(folder, "symbolic link loop: it leads back to a folder it lies in")
                continue
        real = os.path.realpath(folder)
        if real in visited or real in excluded:
            continue
        visited.add(real)
        try:
            entries = _entries(folder)
        except OSError as error:
            yield SourceProblem(folder, _os_cause(error))
            continue
        kind = _folder_kind(folder, entries)
        if kind is not None:
            yield ClipSource(folder, kind, _title(folder, root))
            continue
        yield from _clips_in(folder, entries, root)
        folders = [Path(folder, entry.name) for entry in entries if _is_folder(entry)]
        linked += [path for path in folders if path.is_symlink()]
        pending += [path for path in reversed(folders) if not path.is_symlink()]


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return not entry.name.startswith(".") and entry.is_dir()
    except OSError:
        return False  # a link onto itself; reported among the files if it is named like a video


def _clips_in(folder: Path, entries: list[os.DirEntry[str]], root: Path) -> Iterator[Found]:
    names = {entry.name for entry in entries}
    for entry in entries:
        path = folder / entry.name
        if entry.name.startswith(".") or _is_folder(entry):
            continue
        if path.suffix.lower() not in VIDEO_EXTENSIONS or _is_mask(path, names):
            # a link whose target cannot be followed has no type: report it whatever its name
            if path.is_symlink() and (problem := _unreadable(path)) and "loop" in problem.cause:
                yield problem
            continue
        yield _unreadable(path) or ClipSource(path, "video", _title(path.with_suffix(""), root))


def _is_mask(path: Path, names: set[str]) -> bool:
    return path.stem.endswith("_mask") and path.stem.removesuffix("_mask") + path.suffix in names


def _title(path: Path, root: Path) -> str:
    relative = path.relative_to(root)
    return root.resolve().name if relative == Path(".") else relative.as_posix()


def fingerprint(source: ClipSource) -> str:
    """Return a digest of sizes and modification times of the clip's file, or of all files of its folder.

    Raises:
        OSError: a file cannot be looked at.
    """
    digest = hashlib.sha256()
    files = [source.path]
    if source.path.is_dir():
        files = sorted(path for path in source.path.rglob("*") if path.is_file())
    else:
        files += [path for path in [source.path.with_stem(source.path.stem + "_mask")] if path.is_file()]
    for path in files:
        status = path.stat()
        digest.update(
            os.fsencode(os.path.relpath(path, source.path.parent))
            + f"\0{status.st_size}\0{status.st_mtime_ns}\0".encode()
        )
    return digest.hexdigest()[:16]
