"""Which clips are found below the given paths."""

import os
from pathlib import Path

from inference import ClipSource, find_sources
from inference.results import assign_names
from inference.sources import SourceProblem, fingerprint, source_at


def touch(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"x")
    return path


def clips(found: list) -> list[tuple[str, str]]:
    return [(item.kind, item.title) for item in found if isinstance(item, ClipSource)]


def test_folders_are_walked_in_a_fixed_order_and_captures_are_one_clip(tmp_path: Path) -> None:
    touch(tmp_path / "b.MP4")
    touch(tmp_path / "a" / "deep" / "z.mov")
    touch(tmp_path / "notes.txt")
    touch(tmp_path / ".hidden.mp4")
    touch(tmp_path / "cap" / "capture.json")
    touch(tmp_path / "cap" / "front.mp4")
    touch(tmp_path / "cap" / "side.mp4")
    for k in range(3):
        touch(tmp_path / "frames" / f"{k:03d}.png")
    touch(tmp_path / "pictures" / "holiday.png")
    found = find_sources([tmp_path])
    assert clips(found) == [
        ("video", "b"),
        ("video", "a/deep/z"),
        ("capture", "cap"),
        ("images", "frames"),
    ]
    assert len(found) == 4


def test_masks_beside_videos_are_no_clips(tmp_path: Path) -> None:
    touch(tmp_path / "a.mp4")
    touch(tmp_path / "a_mask.mp4")
    touch(tmp_path / "lonely_mask.mp4")
    assert [title for _, title in clips(find_sources([tmp_path]))] == ["a", "lonely_mask"]


def test_a_clip_named_twice_is_found_once(tmp_path: Path) -> None:
    clip = touch(tmp_path / "sub" / "a.mp4")
    assert len(find_sources([clip, tmp_path, tmp_path / "sub", clip])) == 1


def test_output_folder_is_skipped_also_behind_a_link(tmp_path: Path) -> None:
    touch(tmp_path / "a.mp4")
    touch(tmp_path / "out" / "old.mp4")
    (tmp_path / "link").symlink_to(tmp_path / "out")
    assert clips(find_sources([tmp_path], exclude=[tmp_path / "out"])) == [("video", "a")]


def test_link_loops_are_reported_and_end(tmp_path: Path) -> None:
    touch(tmp_path / "sub" / "a.mp4")
    (tmp_path / "sub" / "up").symlink_to(tmp_path)
    (tmp_path / "self.mp4").symlink_to("self.mp4")
    (tmp_path / "gone.mp4").symlink_to("nowhere.mp4")
    found = find_sources([tmp_path])
    problems = {item.path.name: item.cause for item in found if isinstance(item, SourceProblem)}
    assert clips(found) == [("video", "sub/a")]
    assert problems["up"].startswith("symbolic link loop")
    assert problems["self.mp4"] == "symbolic link loop"
    assert "not there" in problems["gone.mp4"]


def test_linked_folders_elsewhere_are_followed_once(tmp_path: Path) -> None:
    touch(tmp_path / "data" / "a.mp4")
    touch(tmp_path / "other" / "b.mp4")
    (tmp_path / "data" / "link1").symlink_to(tmp_path / "other")
    (tmp_path / "data" / "link2").symlink_to(tmp_path / "other")
    assert [title for _, title in clips(find_sources([tmp_path / "data"]))] == ["a", "link1/b"]


def test_a_missing_path_is_a_problem_not_an_exception(tmp_path: Path) -> None:
    (problem,) = find_sources([tmp_path / "none.mp4"])
    assert isinstance(problem, SourceProblem) and problem.cause == "does not exist"
    assert isinstance(source_at(tmp_path), SourceProblem)


def test_names_are_unique_safe_and_kept(tmp_path: Path) -> None:
    paths = ["a/clip.mp4", "b/clip.mp4", "b/CLIP.mov", "b/clip.mov", "ball été #1.mp4", "x" * 200 + ".mp4"]
    for path in paths:
        touch(tmp_path / path)
    sources = [item for item in find_sources([tmp_path]) if isinstance(item, ClipSource)]
    names = assign_names(sources, {})
    assert len(set(name.casefold() for name in names.values())) == len(paths)
    assert all("/" not in name and len(name.encode()) < 160 for name in names.values())
    by_title = {source.title: names[source.key] for source in sources}
    assert by_title["a/clip"] == "a__clip" and by_title["ball été #1"] == "ball_été_1"
    assert assign_names(sources[::-1], names) == names, "earlier names stay, whatever the order"


def test_two_roots_with_the_same_names(tmp_path: Path) -> None:
    touch(tmp_path / "a" / "clip.mp4")
    touch(tmp_path / "b" / "clip.mp4")
    sources = find_sources([tmp_path / "a", tmp_path / "b"])
    names = assign_names([item for item in sources if isinstance(item, ClipSource)], {})
    assert len(set(names.values())) == 2 and "clip" in names.values()


def test_names_that_are_no_text_do_not_stop_the_walk(tmp_path: Path) -> None:
    (Path(os.fsdecode(os.fsencode(tmp_path) + b"/b\xff.mp4"))).write_bytes(b"x")
    (source,) = find_sources([tmp_path])
    source.key.encode("utf-8")
    assert assign_names([source], {})[source.key].encode("utf-8")


def test_fingerprint_sees_a_changed_file_and_a_changed_mask(tmp_path: Path) -> None:
    source = source_at(touch(tmp_path / "a.mp4"))
    assert isinstance(source, ClipSource)
    first = fingerprint(source)
    assert fingerprint(source) == first
    touch(tmp_path / "a_mask.mp4")
    second = fingerprint(source)
    (tmp_path / "a.mp4").write_bytes(b"longer")
    assert len({first, second, fingerprint(source)}) == 3
