"""Whether views suffice, and whether they agree: what a user is told before the work begins."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.reconstruction.carving import REMEDY, cube_lattice, hull_distance, object_box
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.photo_consistency import nearest_pixels

WIDE = 60.0  # degrees between a camera and a side that it still sees well
TURN = 5.0  # degrees between the azimuths that are tried
CELLS, NEAR = 48, 0.87  # of the lattice along an edge; cells from the hull that still count: half a cell's diagonal
AGREED = 0.995  # mean share of the silhouettes that space common to all explains, of views that agree


def missing_sides(towards: Float[np.ndarray, "C 3"]) -> str:
    """The sides of a body that no camera sees within 60 degrees, in words; empty if there are none.

    Args:
        towards: directions from the body to the cameras.
    """
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)

    def seen(directions: np.ndarray) -> np.ndarray:
        return np.asarray((directions @ towards.T).max(axis=1, initial=-1.0) > np.cos(np.radians(WIDE)) + 1e-9)

    azimuths = np.arange(0.0, 360.0, TURN)
    turns = np.radians(azimuths)
    around = seen(np.stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)], axis=1))
    above, below = seen(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    words = [f"from azimuth {first:g}° to {last:g}°" for first, last in _gaps(azimuths, around)]
    words += ["from above"] * (not above) + ["from below"] * (not below)
    if not words:
        return ""
    note = " (0° is the direction of +x, 90° that of +y)" if not around.all() else ""
    return f"no camera sees the body {' or '.join(words)}{note}"


def _gaps(azimuths: np.ndarray, seen: np.ndarray) -> list[tuple[float, float]]:
    """First and last azimuth of each run of unseen ones around the circle; the last one may exceed 360."""
    if not seen.any():
        return [(0.0, 360.0)]
    start = int(np.flatnonzero(seen)[0])
    turned, values = np.roll(seen, -start), np.concatenate([azimuths[start:], azimuths[:start] + 360.0])
    edges = np.flatnonzero(np.diff(np.concatenate([[1], turned.astype(int), [1]])))
    runs = [(float(values[a]), float(values[b - 1])) for a, b in edges.reshape(-1, 2)]
    return [(first - 360.0, last - 360.0) if last >= 360.0 else (first, last) for first, last in runs]


def disagreement(observations: Sequence[Observation]) -> str:
    """Which camera disagrees most with the others, in words; empty if the silhouettes have nearly all in common.

    Agreement is the mean share of the silhouettes that is covered by the space that projects into all of them. A camera
    with a wrong pose or mask cuts that space; without it, the others agree.
    """
    everything = _agreement(observations)
    if everything >= AGREED:
        return ""
    told = f"the silhouettes of the {len(observations)} cameras have {100 * everything:.0f} % in common"
    if len(observations) < 3:
        names = " and ".join(repr(seen.camera.name) for seen in observations)
        return f"{told}: cameras {names} contradict each other"
    rest = [_agreement([*observations[:k], *observations[k + 1 :]]) for k in range(len(observations))]
    worst = int(np.argmax(rest))
    name = observations[worst].camera.name
    return f"{told}; camera {name!r} disagrees most: without it, the others have {100 * rest[worst]:.0f} %"


def nothing_in_common(observations: Sequence[Observation]) -> InputError:
    """The error that no point in space projects into all silhouettes, with the camera that disagrees most."""
    told = disagreement(observations)
    return InputError(f"masks: no point in space projects into all {len(observations)} of them ({told}); {REMEDY}")


def _agreement(observations: Sequence[Observation]) -> float:
    """Mean share of the silhouettes that the space common to all explains."""
    try:
        centre, half = object_box(observations)
    except InputError:  # the cameras look past each other
        return 0.0
    lattice, cell = cube_lattice(centre, half, CELLS)
    common = lattice[hull_distance(observations, lattice) < NEAR * cell]
    if not len(common):
        return 0.0
    shares = []
    for seen in observations:
        place, depths = nearest_pixels(seen.camera, common)
        shown = np.zeros((seen.camera.h, seen.camera.w), np.uint8)
        shown[place] = 1
        width = 2 * int(np.ceil(cell * seen.camera.fl_x / np.median(depths))) + 1
        covered = cv2.morphologyEx(shown, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8)) > 0
        shares.append(covered[seen.coverage.numpy() > 0.5].mean())
    return float(np.mean(shares))
