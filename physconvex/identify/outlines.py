"""Compares the outlines of masks with the outline of the model's surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.errors import InputError
from physconvex.identify.observations import (
    EvaluatedObservations,
    Observations,
    StackedObservations,
    WrappedObservations,
    camera_jacobian,
)
from physconvex.identify.silhouette import Borders, filled_border
from physconvex.io import Camera

_SHARES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])  # positions of the samples along a silhouette edge
_RIM = 1.6  # pixels inside the model's mask that still count as its outline
_BORDER = 3.0  # pixels from the image border within which an outline may be cut off


def outline_of_mask(
    mask: Bool[np.ndarray, "H W"], count: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """At most `count` points of the outline of a mask in pixel coordinates, and the outward normals there."""
    solid = mask.astype(np.uint8)
    contours, _ = cv2.findContours(solid, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    empty = np.zeros((0, 2))
    if not contours:
        return empty, empty
    pixels = np.concatenate([contour.reshape(-1, 2) for contour in contours])
    smooth = cv2.GaussianBlur(solid.astype(np.float32), (0, 0), 2.0)
    slope = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)], axis=-1)
    normals = -slope[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    length = np.linalg.norm(normals, axis=1)
    height, width = solid.shape
    inside = ((pixels > _BORDER) & (pixels < np.array([width, height]) - 1 - _BORDER)).all(1) & (length > 1e-6)
    pixels, normals = pixels[inside], normals[inside] / length[inside, None]
    chosen = np.unique(np.linspace(0, max(len(pixels) - 1, 0), min(count, len(pixels))).astype(int))
    # the outline runs half a pixel outside the centres of the outermost pixels
    return pixels[chosen] + 0.5 + 0.5 * normals[chosen], normals[chosen]


@dataclass(frozen=True, eq=False)
class OutlineObservations(EvaluatedObservations):
    """Outlines of the masks of one camera.

    The residual of an outline point is its distance, along the outward normal of the mask, to the nearest point of the
    model's outline, over σ. The matched points move with the surface. Each evaluation finds the model's outline among
    the edges between triangles that face the camera and triangles that do not.

    Attributes:
        camera: the camera.
        points: rest positions of the surface's vertices [m], shape [P, 3].
        triangles: of the surface, shape [F, 3].
        pixels: outline points, shape [N, 2].
        normals: outward normals there, shape [N, 2].
        frames: frame of each outline point, shape [N].
        sigma: standard deviation [pixels].
        robust_scale: Huber's threshold in standard deviations.
        drawn: edges [S, 2] and shares [S] of samples of the model's outline by frame; None: found at each evaluation.

    Raises:
        InputError: there is no outline point.
    """

    camera: Camera
    points: Float[np.ndarray, "P 3"]
    triangles: Int[np.ndarray, "F 3"]
    pixels: Float[np.ndarray, "N 2"]
    normals: Float[np.ndarray, "N 2"]
    frames: Int[np.ndarray, " N"]
    sigma: float = 0.7
    robust_scale: float = 3.0
    drawn: Mapping[int, tuple[np.ndarray, np.ndarray]] | None = None

    def __post_init__(self) -> None:
        if not len(self.pixels):
            raise InputError(f"outlines: camera {self.camera.name!r}: no mask shows the object; leave its masks out")

    @classmethod
    def of_masks(
        cls,
        camera: Camera,
        masks: Bool[np.ndarray, "T H W"],
        points: Float[np.ndarray, "P 3"],
        triangles: Int[np.ndarray, "F 3"],
        *,
        per_frame: int = 60,
        sigma: float = 0.7,
    ) -> OutlineObservations:
        """From masks; frame 0, which shows the known rest state, is left out."""
        found = [outline_of_mask(mask, per_frame) for mask in masks[1:]]
        frames = np.repeat(np.arange(1, len(masks)), [len(pixels) for pixels, _ in found])
        pixels, normals = (np.concatenate([pair[k] for pair in found]) for k in (0, 1))
        return cls(camera, points, triangles, pixels, normals, frames, sigma)

    def in_frames(self, count: int) -> OutlineObservations:
        """The first `count` frames alone; the points stay."""
        kept = self.frames < count
        return replace(self, pixels=self.pixels[kept], normals=self.normals[kept], frames=self.frames[kept])

    @cached_property
    def point_indices(self) -> Int[np.ndarray, " N"]:
        """Vertex whose rest position projects nearest to each outline point: an approximate place on the body."""
        projected, _ = self.camera.project(self.points)
        return np.asarray(cKDTree(np.nan_to_num(projected, nan=1e9)).query(self.pixels)[1])

    @property
    def robust_scales(self) -> Float[np.ndarray, " N"]:
        """Huber's thresholds."""
        return np.full(len(self.frames), self.robust_scale)

    @cached_property
    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges shared by two triangles [E, 2], and those triangles [E, 2]."""
        edges = np.sort(self.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        owner = np.repeat(np.arange(len(self.triangles)), 3)
        order = np.lexsort(edges.T)
        edges, owner = edges[order], owner[order]
        same = np.flatnonzero((edges[1:] == edges[:-1]).all(1))
        return edges[same], np.stack([owner[same], owner[same + 1]], axis=1)

    @cached_property
    def _borders(self) -> Borders:
        return Borders(self.triangles)

    def _matches(self, frame: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For the outline points of a frame: the edges [n, 2] and shares [n] of the model's nearest outline points."""
        samples, vertices, shares = self._model_outline(frame, x)
        seen = self.pixels[self.frames == frame]
        if not len(samples):
            return np.zeros((len(seen), 2), dtype=int), np.full(len(seen), np.nan), seen
        _, nearest = cKDTree(samples).query(seen)
        return vertices[nearest], shares[nearest], samples[nearest]

    def with_drawn(self, positions: Float[np.ndarray, "T P 3"]) -> OutlineObservations:
        """The same, with the model's outline fixed at the one of these vertex positions [m]."""
        fresh = self if self.drawn is None else replace(self, drawn=None)
        found = {int(f): fresh._model_outline(int(f), positions[f])[1:] for f in np.unique(self.frames)}
        return replace(self, drawn=found)

    def _model_outline(self, frame: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels [S, 2], edges [S, 2] and shares [S] of samples of the model's outline, vertices at x [m]."""
        if self.drawn is not None:
            vertices, shares = self.drawn[frame]
            pixels, _ = self.camera.project(_between(x, vertices, shares))
            return np.nan_to_num(pixels, nan=1e6), vertices, shares
        corners = x[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = ((self.camera.position - corners[:, 0]) * normals).sum(1) > 0
        edges, owners = self._edges
        edges = edges[facing[owners[:, 0]] != facing[owners[:, 1]]]
        vertices, shares = np.repeat(edges, len(_SHARES), axis=0), np.tile(_SHARES, len(edges))
        pixels, _ = self.camera.project(_between(x, vertices, shares))
        rim = self._on_rim(x, facing, pixels)
        return pixels[rim], vertices[rim], shares[rim]

    def _on_rim(self, x: np.ndarray, facing: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Which pixels lie on the border of the silhouette."""
        drawn, _ = self.camera.project(x)
        border = self._borders.of(facing & np.isfinite(drawn).all(1)[self.triangles].all(1))
        inside = filled_border(drawn[border[:, 0]], drawn[border[:, 1]], self.camera.h, self.camera.w).view(np.uint8)
        depth = cv2.distanceTransform(cv2.copyMakeBorder(inside, 1, 1, 1, 1, cv2.BORDER_CONSTANT), cv2.DIST_L2, 3)
        columns = np.clip(np.nan_to_num(pixels[:, 0], nan=-9), -1, self.camera.w).astype(int) + 1
        rows = np.clip(np.nan_to_num(pixels[:, 1], nan=-9), -1, self.camera.h).astype(int) + 1
        return np.isfinite(pixels).all(1) & (depth[rows, columns] <= _RIM)

    def _evaluate(self, positions: np.ndarray, tangents: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        residuals = np.zeros(len(self.frames))
        jacobian = np.zeros((len(self.frames), 0 if tangents is None else tangents.shape[1]))
        for frame in np.unique(self.frames):
            rows, x = np.flatnonzero(self.frames == frame), positions[frame]
            vertices, share, pixels = self._matches(int(frame), x)
            normals = self.normals[rows] / self.sigma
            known = np.isfinite(share)
            residuals[rows] = np.where(known, ((pixels - self.pixels[rows]) * normals).sum(1), 1e3)
            if tangents is None or not known.all():
                continue
            a, b = vertices.T
            place = _between(x, vertices, share)
            by_place = np.einsum("nc,nci->ni", normals, np.nan_to_num(camera_jacobian(self.camera, place)))
            moved = (1 - share[:, None]) * tangents[frame][:, a] + share[:, None] * tangents[frame][:, b]
            jacobian[rows] = np.einsum("ni,kni->nk", by_place, moved)
        return residuals, jacobian


def _between(x: np.ndarray, edges: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Points [S, 3] at shares [S] of edges [S, 2] between vertices at x."""
    return np.asarray((1 - shares[:, None]) * x[edges[:, 0]] + shares[:, None] * x[edges[:, 1]])


def with_drawn_outlines(seen: Observations, positions: Float[np.ndarray, "T P 3"]) -> Observations:
    """The observations with the model's outlines fixed at those of these positions, for small changes of them.

    Finding the visible outline edges means drawing all triangles, which is by far the most expensive part.
    """
    if isinstance(seen, OutlineObservations):
        return seen.with_drawn(positions)
    if isinstance(seen, StackedObservations):
        pairs = zip(seen.parts, seen.point_slices, strict=True)
        return StackedObservations(tuple(with_drawn_outlines(part, positions[:, where]) for part, where in pairs))
    if isinstance(seen, WrappedObservations):
        return replace(seen, seen=with_drawn_outlines(seen.seen, positions))
    return seen
