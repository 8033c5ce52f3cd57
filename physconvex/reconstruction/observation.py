"""Observation by one camera: image, background, coverage of the object; images summed over what a convex explains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.errors import InputError
from physconvex.io import Camera
from physconvex.render import View, splat

SOFT_RIM = 2  # pixels around a binary mask that the object may touch
MARGIN = 6  # pixels kept around the object when an observation is cropped


@dataclass(frozen=True, eq=False)
class Observation:
    """One view of the object at rest.

    Attributes:
        camera: of these pixels.
        image: the object on its background, shape [H, W, 3], 0 to 1.
        background: image without the object, real or assumed, shape [H, W, 3].
        coverage: share of each pixel that the object covers, shape [H, W].
    """

    camera: Camera
    image: Float[Tensor, "H W 3"]
    background: Float[Tensor, "H W 3"]
    coverage: Float[Tensor, "H W"]

    @property
    def view(self) -> View:
        """The camera as tensors, where the image is."""
        return View.of(self.camera, device=self.image.device)

    def _mapped(self, function: Callable[[Tensor], Tensor], camera: Camera | None = None) -> Observation:
        """The observation of `function(map)`, by another camera if one is given."""
        maps = map(function, (self.image, self.background, self.coverage))
        return Observation(camera or self.camera, *maps)

    @cached_property
    def edge_distance(self) -> Float[np.ndarray, "H W"]:
        """Signed distance of each pixel from the silhouette's edge [pixels], negative inside; on the CPU.

        The edge is where the coverage is one half, between the pixels where that is known.
        """
        coverage = self.coverage.numpy()
        inside = coverage > 0.5
        pixels = distance_transform_edt(~inside) - distance_transform_edt(inside) + np.where(inside, 0.5, -0.5)
        mixed = (np.abs(pixels) < 0.75) & (coverage > 0.02) & (coverage < 0.98)
        return np.where(mixed, 0.5 - coverage, pixels)

    def to(self, device: torch.device | str) -> Observation:
        """The observation on another device."""
        return self._mapped(lambda tensor: tensor.to(device))

    def resized(self, scale: float) -> Observation:
        """The same field of view at a scale of the number of pixels (mean over areas); on the CPU."""
        if scale == 1:
            return self
        size = [max(8, round(scale * edge)) for edge in (self.camera.w, self.camera.h)]
        return self._mapped(
            lambda tensor: torch.from_numpy(cv2.resize(tensor.numpy(), size, interpolation=cv2.INTER_AREA)),
            self.camera.resized(*size),
        )

    def cropped(self) -> Observation:
        """The part around the object; the rest only shows that the object is not there."""
        rows, columns = (torch.nonzero(self.coverage.sum(dim=axis) > 0)[:, 0] for axis in (1, 0))
        if not len(rows):
            return self
        top, left = max(0, int(rows[0]) - MARGIN), max(0, int(columns[0]) - MARGIN)
        bottom, right = int(rows[-1]) + 1 + MARGIN, int(columns[-1]) + 1 + MARGIN
        height, width = self.coverage[top:bottom, left:right].shape
        camera = replace(self.camera, w=width, h=height, cx=self.camera.cx - left, cy=self.camera.cy - top)
        return self._mapped(lambda tensor: tensor[top:bottom, left:right].contiguous(), camera)


def observation_of(
    camera: Camera, frame: UInt8[np.ndarray, "H W 3"], coverage: UInt8[np.ndarray, "H W"] | Bool[np.ndarray, "H W"]
) -> Observation:
    """An observation from a picture and the object's silhouette.

    With 8-bit coverage (the alpha of an image with straight colours) the object is put on white. A mask does not state
    the coverage of the pixels at its rim: there the picture is unchanged, and the background is extrapolated from
    outside, so that a soft edge in front of it explains the mixed pixels.

    Raises:
        InputError: sizes that do not fit, or an empty silhouette.
    """
    if frame.shape != (camera.h, camera.w, 3) or coverage.shape != (camera.h, camera.w):
        raise InputError(
            f"camera {camera.name!r}: got a picture {frame.shape} and a silhouette {coverage.shape}; "
            f"expected {camera.h}×{camera.w} pixels"
        )
    if not coverage.any():
        raise InputError(f"camera {camera.name!r}: its silhouette is empty; remove the camera or correct its mask")
    colours = frame.astype(np.float32) / 255
    share: np.ndarray
    background: np.ndarray
    if coverage.dtype != bool:
        share = coverage.astype(np.float32)[..., None] / 255
        background = np.ones_like(colours)
        colours = share * colours + (1 - share) * background
    else:
        share = coverage.astype(np.float32)[..., None]
        background = _continued(colours, coverage)
    return Observation(camera, *(torch.as_tensor(values) for values in (colours, background, share[..., 0])))


def _continued(colours: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The colours outside a mask and its rim, extrapolated inward as local means."""
    kernel = np.ones((2 * SOFT_RIM + 1, 2 * SOFT_RIM + 1), np.uint8)
    outside = (cv2.dilate(inside.astype(np.uint8), kernel) == 0).astype(np.float32)
    if not outside.any():
        return np.ones_like(colours)
    filled: np.ndarray = np.broadcast_to(colours[outside > 0].mean(axis=0), colours.shape).astype(np.float32)
    for radius in (64, 16, 4):  # coarse means where nothing finer is known
        size = (2 * radius + 1, 2 * radius + 1)
        weight = cv2.blur(outside, size, borderType=cv2.BORDER_CONSTANT)[..., None]
        total = cv2.blur(colours * outside[..., None], size, borderType=cv2.BORDER_CONSTANT)
        mean = np.asarray(total / np.maximum(weight, 1e-6), dtype=np.float32)
        known = np.clip(weight * 20, 0, 1)
        filled = np.asarray(known * mean + (1 - known) * filled)
    return np.where(outside[..., None] > 0, colours, filled).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Gathered:
    """Sums over the pixels p of one or more views, w_ip being the weight of convex i in pixel p.

    Attributes:
        weights: Σ_p w_ip, shape [N]: how many pixels a convex explains.
        values: Σ_p w_ip v_p of the given three-channel images v, shape [N, 3].
    """

    weights: Float[Tensor, " N"]
    values: Float[Tensor, "N 3"]

    def means(self, fallback: Float[Tensor, " 3"]) -> Float[Tensor, "N 3"]:
        """Weighted mean of v over the pixels of each convex; `fallback` for those that explain hardly any pixel."""
        seen = self.weights > 1e-3
        return torch.where(seen[:, None], self.values / torch.where(seen, self.weights, 1.0)[:, None], fallback)


def gather(field: ConvexField, view: View, image: Float[Tensor, "H W 3"]) -> Gathered:
    """Gather an image of a view.

    Rendering is linear in the blended features, so its transpose applied to the image (one backward pass with the image
    as the gradient) gives exactly the sums.
    """
    with torch.no_grad():
        splats, composite = splat(field, view)
    features = splats.features.detach().requires_grad_()
    layers = composite(replace(splats, features=features), view.pixel_coordinates())
    ones = torch.ones_like(image[..., :1])
    (sums,) = torch.autograd.grad(layers.features, features, torch.cat([image, ones], dim=-1))
    found = sums.new_zeros((len(field), 4)).index_add_(0, splats.convex, sums)
    return Gathered(found[:, 3], found[:, :3])
