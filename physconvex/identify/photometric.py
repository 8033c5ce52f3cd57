"""Compares rendered convexes with the images of one camera: the residual of the paper's eq. 9.

The model's points are those of the convexes. In each frame their hulls are drawn over the background (eq. 7), the
colours rotated with the best affine map of each convex, and compared with the image in all pixels around the object.
Images are compared coarse to fine; both are averaged over the same areas and blurred alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import pi, sqrt

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from physconvex.convex import ConvexField, coefficients_of_colour, polar_rotation, view_colours
from physconvex.errors import InputError
from physconvex.identify.observations import EvaluatedObservations
from physconvex.identify.point_models import Positions
from physconvex.io import Camera
from physconvex.render import View, render, render_jacobian, slopes

_OVERSAMPLED = 2  # rendered pixels across one of a coarser image
_UNIT = sqrt(4 * pi)  # of the first harmonic, by a colour that is the same from everywhere
_DRAWN = 0.01  # least opacity of a convex that is drawn: fillings of the inside are not
_AROUND = 0.2  # of the object's size in the image: pixels around it that are compared


@dataclass(frozen=True, eq=False)
class PhotometricObservations(EvaluatedObservations):
    """Images of one camera, compared with a convex field whose points a model moves.

    Attributes:
        camera: of the compared images, which may be smaller than the recorded ones.
        field: convexes at rest [m].
        images: 0 … 1, shape [T, H, W, 3], averaged over areas.
        background: without the object, shape [H, W, 3].
        windows: first row, row after the last, first column, column after the last of the compared pixels, [T, 4].
        blur: width of a Gaussian over both images [pixels]; 0: none.
        fine: rendered pixels across one compared pixel.
        sigma: standard deviation of a colour. Residuals of neighbouring pixels and of the three channels go together,
            over about 25 of them: the default is 0.05 times the root of that.
        exposure: gain and offset of each frame are free (and eliminated).
        robust_scale: Huber's threshold in standard deviations.

    Raises:
        InputError: shapes that do not fit together, or an empty window in every frame.
    """

    camera: Camera
    field: ConvexField
    images: Float[np.ndarray, "T H W 3"]
    background: Float[np.ndarray, "H W 3"]
    windows: Int[np.ndarray, "T 4"]
    blur: float = 0.0
    fine: int = 1
    sigma: float = 0.25
    exposure: bool = True
    robust_scale: float = 0.6

    def __post_init__(self) -> None:
        shape = (self.camera.h, self.camera.w, 3)
        if np.shape(self.images)[1:] != shape or np.shape(self.background) != shape:
            raise InputError(
                f"images, background: got {np.shape(self.images)} and {np.shape(self.background)}; expected [T, H, W, "
                f"3] and [H, W, 3] of camera {self.camera.name!r}, {shape[0]} × {shape[1]} pixels"
            )
        if np.shape(self.windows) != (len(self.images), 4) or not self.sizes.any():
            raise InputError(f"windows: got {np.shape(self.windows)}; expected [{len(self.images)}, 4], not all empty")

    @classmethod
    def of_video(
        cls,
        camera: Camera,
        frames: UInt8[np.ndarray, "T H W 3"],
        masks: Bool[np.ndarray, "T H W"],
        field: ConvexField,
        *,
        scale: float = 1.0,
        blur: float = 0.0,
        exposure: bool = True,
    ) -> PhotometricObservations:
        """Observations at a share of the recorded resolution.

        Args:
            camera: of the recorded frames.
            frames: the observed ones; the first shows the rest state.
            masks: where the object is seen.
            field: convexes at rest [m]; those that are not transparent are drawn.
            scale: of the compared images.
            blur: width of the Gaussian [compared pixels].
            exposure: whether gain and offset of each frame are free.
        """
        size = max(8, round(scale * camera.w)), max(8, round(scale * camera.h))
        small = camera.resized(*size)

        def averaged(image: np.ndarray) -> np.ndarray:
            if size == (camera.w, camera.h):
                return image
            return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))

        images = np.stack([averaged(frame.astype(np.float32) / 255) for frame in frames])
        background = averaged(background_of(frames, masks))
        extent = np.array([_extent(mask) for mask in masks])
        reach = _AROUND * max(1, int((extent[:, 1::2] - extent[:, ::2]).max()))
        shares = np.array([size[1] / camera.h, size[1] / camera.h, size[0] / camera.w, size[0] / camera.w])
        grown = (extent + reach * np.array([-1, 1, -1, 1])) * shares
        windows = np.stack(
            [np.floor(grown[:, 0]), np.ceil(grown[:, 1]), np.floor(grown[:, 2]), np.ceil(grown[:, 3])], 1
        )
        windows = np.clip(windows, 0, [size[1], size[1], size[0], size[0]]).astype(np.int64)
        windows[extent[:, 1] <= extent[:, 0]] = 0  # no object in that frame
        fine = 1 if size == (camera.w, camera.h) else _OVERSAMPLED
        drawn = field.select(field.opacity > _DRAWN)
        return cls(small, drawn, images, background, windows, blur, fine, exposure=exposure)

    @property
    def points(self) -> Float[np.ndarray, "P 3"]:
        """Points of the convexes at rest [m]."""
        return self.field.points.detach().double().numpy().reshape(-1, 3)

    @property
    def sizes(self) -> Int[np.ndarray, " T"]:
        """Number of compared pixels in each frame."""
        return (self.windows[:, 1] - self.windows[:, 0]) * (self.windows[:, 3] - self.windows[:, 2])

    @cached_property
    def frames(self) -> Int[np.ndarray, " N"]:
        """Frame of each residual."""
        return np.repeat(np.arange(len(self.images)), 3 * self.sizes)

    @property
    def point_indices(self) -> Int[np.ndarray, " N"]:
        """The first point of the convex that covers the pixel most at rest; of the first convex, outside the object."""
        seen = render(self.field, self.camera).convex.clamp(min=0).numpy() * self.field.points.shape[1]
        parts = [seen[a:b, c:d].ravel() for a, b, c, d in self.windows]
        return np.repeat(np.concatenate(parts), 3)

    @property
    def robust_scales(self) -> Float[np.ndarray, " N"]:
        """Huber's thresholds."""
        return np.full(len(self.frames), self.robust_scale)

    def in_frames(self, count: int) -> PhotometricObservations:
        """The first `count` frames alone."""
        return replace(self, images=self.images[:count], windows=self.windows[:count])

    def visible_in(self, positions: Positions, *, least: float = 0.02) -> PhotometricObservations:
        """The same without convexes whose weights, summed over pixels, stay below `least` in every frame of a motion.

        Few convexes of a body show, and the others cost as much.
        """
        kind, seen = self.field.points, torch.zeros(len(self.field), dtype=torch.bool)
        for frame in np.flatnonzero(self.sizes):
            view = self._view(self.windows[frame])
            moved = torch.as_tensor(positions[frame]).to(kind).reshape(kind.shape)
            colours = torch.zeros((len(self.field), 1, 3), dtype=kind.dtype, requires_grad=True)
            image = render(replace(self.field, points=moved, harmonics=colours), view).colour[..., 0]
            (weights,) = torch.autograd.grad(image.sum(), colours)
            seen |= _UNIT * weights[:, 0, 0] > least * self.fine**2
        return replace(self, field=self.field.select(seen))

    @cached_property
    def _inverses(self) -> Float[Tensor, "N 3 K"]:
        """Pseudo-inverses of each convex's points about their mean: with the moved points they give the affine map."""
        rest = self.field.points.double()
        return torch.linalg.pinv(rest - rest.mean(dim=1, keepdim=True), rtol=1e-3).to(self.field.points)

    def field_at(self, points: Float[Tensor, "N K 3"], position: Float[Tensor, " 3"]) -> ConvexField:
        """The field with moved points [m] and the colours seen from a position [m], in place of harmonics.

        Colours turn with the best affine map of each convex: they are those of the field at rest along the direction of
        view turned back.
        """
        return replace(self.field, points=points, harmonics=coefficients_of_colour(self._colours(points, position), 0))

    def _colours(self, points: Float[Tensor, "N K 3"], position: Float[Tensor, " 3"]) -> Float[Tensor, "N 3"]:
        centres = points.mean(dim=1)
        directions = torch.nn.functional.normalize(centres - position, dim=1)
        if self.field.harmonics.shape[1] > 1:
            gradients = (self._inverses @ (points - centres[:, None])).mT
            directions = (directions[:, None] @ polar_rotation(gradients))[:, 0]  # Rᵀ d
        return view_colours(self.field.harmonics, directions)

    def _view(self, window: Sequence[int]) -> View:
        """The part of the camera that is rendered: the window, with finer pixels."""
        a, b, c, d = window
        camera = self.camera.resized(self.fine * self.camera.w, self.fine * self.camera.h)
        x, y = self.fine * c, self.fine * a
        part = replace(camera, w=self.fine * (d - c), h=self.fine * (b - a), cx=camera.cx - x, cy=camera.cy - y)
        return View.of(part, self.field.points.dtype)

    def _behind(self, window: Sequence[int]) -> Float[Tensor, "H W 3"]:
        """The background of a window, in rendered pixels."""
        a, b, c, d = window
        behind = self.background[a:b, c:d].repeat(self.fine, axis=0).repeat(self.fine, axis=1)
        return torch.as_tensor(behind).to(self.field.points)

    def rendered(self, points: Float[Tensor, "N K 3"], window: Sequence[int]) -> Float[Tensor, "h w 3"]:
        """A window of the image as it is compared, but for the blur; differentiable by the moved points [m]."""
        view = self._view(window)
        return self._rendered(self.field_at(points, view.position), view, self._behind(window))

    def _rendered(self, field: ConvexField, view: View, background: Tensor) -> Float[Tensor, "h w 3"]:
        return self._averaged(render(field, view, background=background).colour)

    def _averaged(self, images: Float[Tensor, "*B H W 3"]) -> Float[Tensor, "*B h w 3"]:
        """Rendered images as they are compared: averaged over areas."""
        height, width = images.shape[-3] // self.fine, images.shape[-2] // self.fine
        parts = images.unflatten(-3, (height, self.fine)).unflatten(-2, (width, self.fine))
        return parts.mean(dim=(-4, -2))

    def blurred(self, image: np.ndarray) -> np.ndarray:
        """A window [h, w, ...], blurred; the border repeats."""
        if not self.blur or not image.size:
            return image
        flat = np.ascontiguousarray(image.reshape(*image.shape[:2], -1))
        done = [
            cv2.GaussianBlur(flat[..., k], (0, 0), self.blur, borderType=cv2.BORDER_REPLICATE)
            for k in range(flat.shape[2])
        ]
        return np.stack(done, axis=-1).reshape(image.shape)

    def _evaluate(self, positions: np.ndarray, tangents: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        count = 0 if tangents is None else tangents.shape[1]
        residuals, jacobian = [], []
        for frame in np.flatnonzero(self.sizes):
            window = self.windows[frame]
            rows = slice(window[0], window[1]), slice(window[2], window[3])
            drawn, slopes = self._drawn(positions[frame], None if tangents is None else tangents[frame], window)
            seen = self.blurred(self.images[frame][rows])
            value, slopes = self._balanced(seen, self.blurred(drawn), self.blurred(slopes))
            residuals.append(value.ravel() / self.sigma)
            jacobian.append(slopes.reshape(value.size, count) / self.sigma)
        return np.concatenate(residuals), np.concatenate(jacobian)

    def _drawn(
        self, points: Float[np.ndarray, "P 3"], tangents: Float[np.ndarray, "K P 3"] | None, window: Sequence[int]
    ) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 3 K"]]:
        """A window as rendered, and its derivatives."""
        view, kind = self._view(window), self.field.points
        moved, background = torch.as_tensor(points).to(kind).reshape(kind.shape), self._behind(window)
        with torch.no_grad():
            field = self.field_at(moved, view.position)
            drawn = self._rendered(field, view, background).numpy()
        if tangents is None or not len(tangents):
            return drawn, np.zeros((*drawn.shape, 0), dtype=drawn.dtype)
        # moves of the size of a pixel, so that single precision does not lose small derivatives
        sizes = np.abs(tangents).max(axis=(1, 2)) + 1e-30
        along = torch.as_tensor(tangents / sizes[:, None, None]).to(kind).reshape(-1, *kind.shape)
        (turned,) = slopes(lambda at: (self._colours(at, view.position),), moved, along)
        assert turned is not None
        colours = _UNIT * turned[:, :, None]

        def scene(changes: Tensor) -> tuple[ConvexField, View]:
            points = field.points + torch.einsum("k,knpi->npi", changes, along)
            harmonics = field.harmonics + torch.einsum("k,knsc->nsc", changes, colours)
            return replace(field, points=points, harmonics=harmonics), view

        found = render_jacobian(scene, kind.new_zeros(len(along)), background=background).colour  # [K, H, W, 3]
        rates = self._averaged(found).permute(1, 2, 3, 0).numpy()
        return drawn, rates * sizes

    def _balanced(self, seen: np.ndarray, drawn: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Drawn less seen, and its derivatives, after the fit of a gain and an offset of the drawn colours."""
        difference = np.asarray(drawn - seen, dtype=np.float64)
        slopes = np.asarray(slopes, dtype=np.float64)
        if not self.exposure:
            return difference, slopes
        basis = np.linalg.qr(np.stack([seen.ravel(), np.ones(seen.size)], axis=1).astype(np.float64))[0]

        def left(columns: np.ndarray) -> np.ndarray:
            return columns - basis @ (basis.T @ columns)

        flat = left(slopes.reshape(difference.size, slopes.shape[-1]))
        return left(difference.reshape(-1, 1)).reshape(difference.shape), flat.reshape(slopes.shape)


def background_of(frames: UInt8[np.ndarray, "T H W 3"], masks: Bool[np.ndarray, "T H W"]) -> Float[np.ndarray, "H W 3"]:
    """What a still camera sees behind the object, 0 … 1: the median of the frames that show it.

    Pixels that the object always covers get the median of all others.
    """
    behind = np.where(masks[..., None], np.nan, frames.astype(np.float32) / 255)
    hidden = masks.all(axis=0)
    behind[:, hidden] = np.nanmedian(behind[:, ~hidden], axis=(0, 1)) if not hidden.all() else 1.0
    return np.asarray(np.nanmedian(behind, axis=0), dtype=np.float32)


def _extent(mask: Bool[np.ndarray, "H W"]) -> tuple[int, int, int, int]:
    """First row, row after the last, first column, column after the last; zeros for an empty mask."""
    if not mask.any():
        return 0, 0, 0, 0
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
