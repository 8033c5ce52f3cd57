"""One error per way in which a video can be bad."""

from pathlib import Path
from typing import Literal

from physconvex.errors import InputError

VideoCause = Literal[
    "missing",
    "permission",
    "empty_file",
    "not_a_video",
    "no_video_stream",
    "truncated",
    "too_few_frames",
    "too_large",
    "undecodable",
]


class VideoError(InputError):
    """A video that cannot be read.

    The message is one line that names the file, what is wrong and the remedy; `cause` is one word of
    a closed set, for programs.
    """

    def __init__(self, path: Path | str, cause: VideoCause, detail: str) -> None:
        super().__init__(f"{path}: {detail} [{cause}]")
        self.path = Path(path)
        self.cause: VideoCause = cause
        self.detail = detail

    def __reduce__(self) -> tuple[type["VideoError"], tuple[Path, VideoCause, str]]:
        """Lets the error be pickled between processes (the default passes the message as the only argument)."""
        return type(self), (self.path, self.cause, self.detail)
