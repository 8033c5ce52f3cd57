"""Compares the colours of the first image, moved with the model, with those of the later images of one camera.

A material point at x_t has the pixel π(x_t). Its colour there should equal its colour in the first image (direct
alignment, Lucas & Kanade 1981). Both images have the same blur. A wide blur converges from far away, a narrow one is
accurate: fits go from coarse to fine. An approximate model gives the frames in which each point is visible.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from physconvex.errors import InputError
from physconvex.identify.observations import EvaluatedObservations, PointwiseObservations, camera_jacobian
from physconvex.identify.visible_points import Hits, cast_camera_rays, cast_rays, unit_normals
from physconvex.io import Camera

_GRAZING = 0.35  # least sine between surface and ray
_BEHIND = 0.03  # of the body's size: tolerance of the depth test


def blurred(images: UInt8[np.ndarray, "T H W 3"], width: float) -> Float[np.ndarray, "T H W 3"]:
    """Images in 0 … 1, blurred by a Gaussian of that width [pixels]."""
    return np.stack([cv2.GaussianBlur(image.astype(np.float32) / 255.0, (0, 0), width) for image in images])


def colour_seeds(
    camera: Camera,
    image: UInt8[np.ndarray, "H W 3"],
    vertices: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "F 3"],
    *,
    count: int = 400,
    mask: Bool[np.ndarray, "H W"] | None = None,
    margin: int = 3,
) -> Hits:
    """At most `count` surface points where the first image has contrast, evenly spread.

    Args:
        camera, image: of the first image.
        vertices, triangles: the surface at rest.
        mask: where the object is seen; the surface's own outline unless given.
        margin: distance from the outline [pixels].
    """
    inside = cast_camera_rays(camera, vertices, triangles).faces >= 0
    if mask is not None:
        inside &= mask
    inner = cv2.erode(inside.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) > 0
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.0)
    contrast = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    cell = max(1, round(float(np.sqrt(inner.sum() / max(count, 1)))))
    rows, columns = np.nonzero(inner)
    order = np.argsort(-contrast[rows, columns], kind="stable")
    cells = (rows // cell) * (inner.shape[1] // cell + 1) + columns // cell
    best = order[np.unique(cells[order], return_index=True)[1]]  # the one of highest contrast in each cell
    best = best[np.unique(np.linspace(0, max(len(best) - 1, 0), min(count, len(best))).astype(int))]
    pixels = np.stack([columns[best], rows[best]], axis=1) + 0.5
    if not len(pixels):
        return Hits(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    origin, directions = camera.rays(pixels)
    struck = cast_rays(origin, directions, vertices, triangles)
    hit = struck.faces >= 0
    return Hits(struck.faces[hit], struck.barycentric[hit])


def seen_by(
    camera: Camera,
    moved: Float[np.ndarray, "T V 3"],
    triangles: Int[np.ndarray, "F 3"],
    positions: Float[np.ndarray, "T P 3"],
    faces: Int[np.ndarray, " P"],
    *,
    margin: float = 3.0,
) -> Bool[np.ndarray, "T P"]:
    """Which points of a moving surface a camera sees: in the image, not hidden, away from every outline.

    The triangle of a point faces the camera as in the first frame, and not at a grazing angle. The pixels `margin`
    above, below, left and right of the point show a similar depth, so that a blur of half that width mixes in no other
    surface. A point that does not pass in the first frame is never compared.

    Args:
        camera: of the images.
        moved, triangles: the surface [m].
        positions: of the points [m].
        faces: the triangle that each point lies in.
        margin: distance from outlines [pixels].
    """
    out = np.zeros(positions.shape[:2], dtype=bool)
    reach = _BEHIND * float(np.ptp(moved[0], axis=0).max())
    around = margin * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    side = np.zeros(positions.shape[1])
    for t, (surface, points) in enumerate(zip(moved, positions, strict=True)):
        pixels, depth = camera.project(points)
        known = np.isfinite(pixels).all(1) & (depth > 0)
        known &= ((pixels > margin) & (pixels < np.array([camera.w, camera.h]) - margin)).all(1)
        origin, directions = camera.rays(np.where(known[:, None], pixels, 0.0) + around[:, None])
        struck = cast_rays(origin, directions, surface, triangles)
        gap = np.linalg.norm(struck.on(surface, triangles) - points, axis=-1)
        wide = reach + margin / _GRAZING * depth / min(camera.fl_x, camera.fl_y)  # the surface slants
        known &= (np.nan_to_num(gap[0], nan=np.inf) < reach) & (np.nan_to_num(gap[1:], nan=np.inf) < wide).all(0)
        facing = (unit_normals(surface, triangles[faces]) * directions[0]).sum(-1)
        if t == 0:
            side = np.sign(facing)
        out[t] = known & (side * facing > _GRAZING)
    return out & out[0]


@dataclass(frozen=True, eq=False)
class ColourObservations(EvaluatedObservations, PointwiseObservations):
    """Colours of material points in the images of one camera.

    The residual is the image at the predicted pixel minus the point's colour in the first image, divided by σ.

    Attributes:
        camera: the camera.
        points: rest positions [m], shape [P, 3].
        images: blurred images, 0 … 1, shape [T, H, W, 3]; the first shows the rest state.
        visible: which points are compared in which frame, shape [T, P]; the first frame is left out.
        sigma: standard deviation of a colour.
        exposure: gain and offset of each frame are free (and eliminated).
        robust_scale: Huber's threshold in standard deviations.

    Raises:
        InputError: no point is visible after the first frame.
    """

    camera: Camera
    points: Float[np.ndarray, "P 3"]
    images: Float[np.ndarray, "T H W 3"]
    visible: Bool[np.ndarray, "T P"]
    sigma: float = 0.06
    exposure: bool = True
    robust_scale: float = 3.0
    width: ClassVar[int] = 3

    def __post_init__(self) -> None:
        if not len(self.frames):
            raise InputError(f"colours: camera {self.camera.name!r} sees no point again after the first frame")

    @cached_property
    def seen(self) -> Bool[np.ndarray, "T P"]:
        """Which points are compared in which frame: none in the first."""
        later = self.visible.copy()
        later[0] = False
        return later

    @cached_property
    def colours(self) -> Float[np.ndarray, "P 3"]:
        """Colours of the points in the first image."""
        return _sampled(self.images[0], self.camera.project(self.points)[0])

    def in_frames(self, count: int) -> ColourObservations:
        """The first `count` frames alone."""
        return replace(self, images=self.images[:count], visible=self.visible[:count])

    def _evaluate(self, positions: np.ndarray, tangents: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        count = 0 if tangents is None else tangents.shape[1]
        residuals, jacobian = [], []
        for frame in np.unique(self.pairs[0]):
            points = self.pairs[1][self.pairs[0] == frame]
            x = positions[frame, points]
            pixels, _ = self.camera.project(x)
            found = _sampled(self.images[frame], pixels)
            rows = np.zeros((len(points), 3, count))
            if tangents is not None:
                image = self.images[frame]
                beside = ((_sampled(image, pixels + one), _sampled(image, pixels - one)) for one in np.eye(2))
                slopes = np.stack([0.5 * (after - before) for after, before in beside], axis=-1)  # [n, 3, 2]
                by_place = np.nan_to_num(slopes @ camera_jacobian(self.camera, x))
                rows = np.einsum("nci,kni->nck", by_place, tangents[frame][:, points])
            value, rows = self._balanced(found, self.colours[points], rows)
            residuals.append(value.ravel() / self.sigma)
            jacobian.append(rows.reshape(value.size, count) / self.sigma)
        return np.concatenate(residuals), np.concatenate(jacobian)

    def _balanced(self, found: np.ndarray, first: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Differences of colours after the fit of a gain and an offset."""
        difference = found - first
        if not self.exposure or len(found) < 4:
            return difference, rows
        basis = np.linalg.qr(np.stack([first.ravel(), np.ones(first.size)], axis=1))[0]

        def left(columns: np.ndarray) -> np.ndarray:
            return columns - basis @ (basis.T @ columns)

        flat = rows.reshape(first.size, rows.shape[-1])
        return left(difference.reshape(-1, 1)).reshape(difference.shape), left(flat).reshape(rows.shape)


def _sampled(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Bilinear colours [n, 3] at pixel coordinates [n, 2]; outside the image, the colour of its border."""
    columns, rows = np.nan_to_num(pixels - 0.5, nan=-1.0).astype(np.float32).T[:, None]
    found = cv2.remap(np.ascontiguousarray(image), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found[0], dtype=np.float64)
