"""A pinhole camera as tensors, so that images can be differentiated with respect to it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd import forward_ad

from physconvex.io import UNDISTORT_ITERATIONS, Camera


@dataclass(frozen=True, eq=False)
class View:
    """The contents of a `physconvex.io.camera.Camera` as tensors; the same conventions.

    Points are first projected to the plane at unit distance before the camera, with coordinates (u, v) = (x, y) /
    depth, u to the right and v down. A pixel shows the point of that plane on its (undistorted) ray.

    Attributes:
        width, height: image size [pixels].
        focal: focal lengths (horizontal, vertical), shape [2], pixels.
        principal: principal point, shape [2], pixels.
        rotation: camera-to-world rotation, OpenGL axes, shape [3, 3].
        position: of the camera, shape [3], metres.
        distortion: k1 and k2 of OpenCV's model, shape [2].
    """

    width: int
    height: int
    focal: Float[Tensor, " 2"]
    principal: Float[Tensor, " 2"]
    rotation: Float[Tensor, "3 3"]
    position: Float[Tensor, " 3"]
    distortion: Float[Tensor, " 2"]

    @classmethod
    def of(cls, camera: Camera, dtype: torch.dtype = torch.float32, *, device: torch.device | str = "cpu") -> View:
        """The view of a camera."""

        def tensor(values: object) -> Tensor:
            return torch.tensor(values, dtype=dtype, device=device)

        matrix = tensor(camera.transform_matrix)
        return cls(
            camera.w,
            camera.h,
            tensor([camera.fl_x, camera.fl_y]),
            tensor([camera.cx, camera.cy]),
            matrix[:3, :3],
            matrix[:3, 3],
            tensor([camera.k1, camera.k2]),
        )

    def to(self, target: torch.dtype | torch.device | str) -> View:
        """The view in another floating type or on another device."""
        tensors = (self.focal, self.principal, self.rotation, self.position, self.distortion)
        return View(self.width, self.height, *(tensor.to(target) for tensor in tensors))

    def moved(self, twist: Float[Tensor, " 6"]) -> View:
        """The view shifted by `twist[:3]` [m] and rotated by the rotation vector `twist[3:]` [rad], in camera axes."""
        zero = torch.zeros_like(twist[0])
        x, y, z = twist[3:].unbind()
        skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
        position = self.position + self.rotation @ twist[:3]
        return replace(self, rotation=self.rotation @ torch.linalg.matrix_exp(skew), position=position)

    def local(self, points: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
        """World points [m] in axes right, down, forward of the camera; the third coordinate is the depth."""
        right_up_back = (points - self.position) @ self.rotation
        return right_up_back * right_up_back.new_tensor([1.0, -1.0, -1.0])

    def pixel_coordinates(self) -> Float[Tensor, "height width 2"]:
        """Undistorted coordinates of each pixel centre on the plane at unit distance."""
        columns, rows = (
            torch.arange(size, device=self.focal.device).to(self.focal) + 0.5 for size in (self.width, self.height)
        )
        pixels = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1)
        distorted = (pixels - self.principal) / self.focal
        followed = self.distortion.requires_grad or forward_ad.unpack_dual(self.distortion).tangent is not None
        if not self.distortion.detach().any() and not followed:
            return distorted
        plane = distorted
        k1, k2 = self.distortion.unbind()
        for _ in range(UNDISTORT_ITERATIONS):  # r_distorted = r (1 + k1 r² + k2 r⁴), as in Camera.rays
            squared = plane.square().sum(dim=-1, keepdim=True)
            plane = distorted / (1 + squared * (k1 + squared * k2))
        return plane
