"""The first frames of a long capture, in the place of all of them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from physconvex.gap.thresholds import BASE_FIT
from physconvex.io import Boundary, Capture, Tracks

__all__ = ["shortened"]


@dataclass(frozen=True, eq=False)
class _Beginning(Capture):
    """A capture of which only the first `frames` frames are used.

    Attributes:
        whole: all of it.
    """

    whole: Capture | None = None

    def tracks(self) -> Tracks | None:
        """Marker tracks of the first frames."""
        assert self.whole is not None
        tracks = self.whole.tracks()
        if tracks is None:
            return None
        return replace(tracks, positions=tracks.positions[: self.frames], sigma=tracks.sigma[: self.frames])

    def boundary(self) -> Boundary | None:
        """What is held, and how it moves in the first frames."""
        assert self.whole is not None
        boundary = self.whole.boundary()
        if boundary is None or boundary.motion is None:
            return boundary
        return replace(boundary, motion=boundary.motion[: self.frames])


def shortened(capture: Capture, most: int = BASE_FIT.most_frames) -> Capture:
    """A capture with no more than so many frames, of which the same share, two thirds at most, is observed.

    A diagnosis simulates a capture some hundred times, and open-loop models part from long recordings anyway.
    """
    if capture.frames <= most:
        return capture
    stated = {field.name: getattr(capture, field.name) for field in fields(Capture) if field.init}
    stated |= {"frames": most, "observed_frames": min(capture.observed_frames, 2 * most // 3)}
    return _Beginning(**stated, whole=capture)
