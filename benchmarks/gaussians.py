"""3D Gaussians (Kerbl et al. 2023), a small reference for comparisons with convexes, from the paper's equations.

A Gaussian has a centre, a covariance Σ = R S Sᵀ Rᵀ (eq. 6), an opacity and the same harmonics as a convex: 59 numbers
at degree 3. In an image its covariance is J W Σ Wᵀ Jᵀ (eq. 5, Zwicker et al. 2001) plus that of a pixel. Blending goes
by the same limits as that of the convexes (`physconvex.render.reference`); images without distortion only.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.autograd.function import once_differentiable

from physconvex.convex import view_colours
from physconvex.kernels import SOURCES, compiled
from physconvex.render import RENDER_FLAGS, RenderedImage, View

__all__ = ["Gaussians", "blend_gaussians", "quaternions_of", "render_gaussians", "rotation_matrices"]

NEAR = 0.01  # [m]
PIXEL_VARIANCE = 0.3  # low-pass filter of an image [pixels²]
WIDEST_TANGENT = 1.3  # of the field of view: J is taken no farther out


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N Gaussians in coordinates without bounds.

    Attributes:
        centres: shape [N, 3], metres.
        log_scales: logarithms of the standard deviations along the own axes [m], shape [N, 3].
        quaternions: (w, x, y, z) of the own axes, of any length, shape [N, 4].
        logit_opacity: shape [N].
        harmonics: as of a `ConvexField`, shape [N, S, 3].
    """

    centres: Tensor
    log_scales: Tensor
    quaternions: Tensor
    logit_opacity: Tensor
    harmonics: Tensor

    def __len__(self) -> int:
        return len(self.centres)

    def tensors(self) -> tuple[Tensor, ...]:
        """All attributes, in the order of their declaration."""
        return tuple(getattr(self, entry.name) for entry in fields(self))

    def select(self, which: Tensor) -> Gaussians:
        """Those, by indices or a mask."""
        return Gaussians(*(tensor[which] for tensor in self.tensors()))

    def leaves(self) -> Gaussians:
        """The same numbers as leaves of a new graph."""
        return Gaussians(*(tensor.detach().clone().requires_grad_() for tensor in self.tensors()))


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Of quaternions (w, x, y, z) of any length, shape [N, 3, 3]."""
    w, x, y, z = (quaternions / quaternions.norm(dim=1, keepdim=True)).unbind(dim=1)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(entries, dim=1).reshape(-1, 3, 3)


def quaternions_of(rotations: Tensor) -> Tensor:
    """Quaternions (w, x, y, z) of rotation matrices, shape [N, 4]."""
    turned = Rotation.from_matrix(rotations.double().numpy()).as_quat()
    return torch.as_tensor(np.roll(turned, 1, axis=1)).to(rotations)


def render_gaussians(scene: Gaussians, view: View, *, background: Tensor | None = None) -> RenderedImage:
    """Draw them, differentiable with respect to their numbers; `convex` of the image is −1 everywhere."""
    layers, _ = blend_gaussians(scene, view)
    features, transmittance = layers
    white = torch.ones(3) if background is None else background
    colour = features[..., :3] + transmittance[..., None] * white
    return RenderedImage(colour, 1 - transmittance, features[..., 3], torch.full_like(transmittance, -1).long())


def blend_gaussians(
    scene: Gaussians, view: View, *, replaced: Tensor | None = None
) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Blended features and transmittance, and which Gaussians were drawn; `replaced` [N, 4] stands for the features."""
    local = view.local(scene.centres)
    drawn = (local.detach()[:, 2] > NEAR).nonzero()[:, 0]
    drawn = drawn[local.detach()[drawn, 2].argsort(stable=True)]
    places, conics = _projected(scene.select(drawn), local[drawn], view)
    directions = scene.centres - view.position
    directions = directions / directions.norm(dim=1, keepdim=True)
    features = replaced
    if features is None:
        features = torch.cat([view_colours(scene.harmonics, directions), local[:, 2:]], dim=1)
    opacity = torch.sigmoid(scene.logit_opacity)
    size = (view.width, view.height)
    return _Blend.apply(size, places, conics, opacity[drawn], features[drawn]), drawn


def _projected(scene: Gaussians, local: Tensor, view: View) -> tuple[Tensor, Tensor]:
    """Centres [pixels] and inverse covariances (a, b, c) [1/pixels²]."""
    depth = local[:, 2]
    plane = local[:, :2] / depth[:, None]
    places = plane * view.focal + view.principal
    most = WIDEST_TANGENT * 0.5 * torch.tensor([view.width, view.height]) / view.focal.detach()
    tangent = torch.minimum(torch.maximum(plane, -most), most)
    zero = torch.zeros_like(depth)
    slopes = torch.stack(
        [
            torch.stack([view.focal[0] / depth, zero, -view.focal[0] * tangent[:, 0] / depth], dim=1),
            torch.stack([zero, view.focal[1] / depth, -view.focal[1] * tangent[:, 1] / depth], dim=1),
        ],
        dim=1,
    )  # J
    to_local = view.rotation.T * view.rotation.new_tensor([[1.0], [-1.0], [-1.0]])  # W
    spread = slopes @ to_local @ (rotation_matrices(scene.quaternions) * scene.log_scales.exp()[:, None])
    covariance = spread @ spread.transpose(1, 2)
    a, b, c = covariance[:, 0, 0] + PIXEL_VARIANCE, covariance[:, 0, 1], covariance[:, 1, 1] + PIXEL_VARIANCE
    return places, torch.stack([c, -b, a], dim=1) / (a * c - b * b)[:, None]


class _Splats(ctypes.Structure):
    """`struct Splats` of gaussian_kernel/kernel.cpp."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("width", "height", "count", "threads")),
        *((name, ctypes.c_void_p) for name in ("centres", "conics", "opacity", "features")),
    )


@cache
def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(
        str(compiled(Path(__file__).with_name("gaussian_kernel"), include=[SOURCES / "render"], flags=RENDER_FLAGS))
    )
    scene: Any = ctypes.POINTER(_Splats)
    pointer: Any = ctypes.c_void_p
    library.gs_blend.argtypes, library.gs_blend.restype = [scene, pointer, pointer], None
    library.gs_gradient.argtypes, library.gs_gradient.restype = [scene, *[pointer] * 8], None
    return library


class _Blend(torch.autograd.Function):
    """Blending as a function of centres, conics, opacity, features."""

    @staticmethod
    def forward(ctx: Any, size: tuple[int, int], *inputs: Tensor) -> tuple[Tensor, Tensor]:
        given = [tensor.detach().float().contiguous() for tensor in inputs]
        width, height = size
        features, transmittance = torch.empty(height, width, 4), torch.empty(height, width)
        scene = _scene(size, given)
        _library().gs_blend(ctypes.byref(scene), features.data_ptr(), transmittance.data_ptr())
        ctx.size, ctx.given = size, given
        ctx.save_for_backward(features, transmittance)
        return features, transmittance

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        found = [torch.empty_like(tensor) for tensor in ctx.given]
        given = [*ctx.saved_tensors, *(tensor.float().contiguous() for tensor in gradients)]
        scene = _scene(ctx.size, ctx.given)
        _library().gs_gradient(ctypes.byref(scene), *(tensor.data_ptr() for tensor in (*given, *found)))
        return None, *found


def _scene(size: tuple[int, int], given: Sequence[Tensor]) -> _Splats:
    pointers = [tensor.data_ptr() for tensor in given]
    return _Splats(*size, len(given[0]), torch.get_num_threads(), *pointers)
