"""Pinhole cameras in the nerfstudio convention.

The camera looks along its −z axis, x to the right, y up (OpenGL axes); `transform_matrix` maps camera to world
coordinates. Pixel (0, 0) is the upper left corner of the upper left pixel, so the centre of that pixel is
(0.5, 0.5) and an image without offset has its principal point at (w/2, h/2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from physconvex.errors import InputError
from physconvex.io.configuration import Expected, in_words

Vector = Sequence[float] | np.ndarray
UNDISTORT_ITERATIONS = 20


_Row = tuple[float, float, float, float]
Pixels = Annotated[int, Field(gt=0), Expected("a positive whole number")]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False), Expected("a positive number")]
Finite = Annotated[float, Field(allow_inf_nan=False), Expected("a number")]


class CameraEntry(BaseModel):
    """A pinhole camera in `capture.json`: nerfstudio's names, and a name of its own."""

    model_config = ConfigDict(frozen=True, extra="ignore", use_attribute_docstrings=True)

    name: Annotated[str, Expected("a name")]
    """Name of the camera, also of its files."""
    w: Pixels
    """Width of its images [pixels]."""
    h: Pixels
    """Height of its images [pixels]."""
    fl_x: Length
    """Focal length along x [pixels]."""
    fl_y: Length
    """Focal length along y [pixels]."""
    cx: Finite
    """Principal point, from the left border of the image [pixels]."""
    cy: Finite
    """Principal point, from the upper border of the image [pixels]."""
    transform_matrix: Annotated[tuple[_Row, _Row, _Row, _Row], Expected("a finite 4×4 matrix")]
    """Camera-to-world, rigid [m]; the camera looks along −z, x to the right, y up (OpenGL axes)."""
    k1: Finite = 0.0
    """Radial distortion (OpenCV: r → r (1 + k1 r² + k2 r⁴))."""
    k2: Finite = 0.0
    """Radial distortion of fourth order."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with optional radial distortion.

    Attributes:
        name: the name of the camera, also of its files in a capture.
        w, h: image size [pixels].
        fl_x, fl_y: focal lengths [pixels].
        cx, cy: principal point [pixels].
        transform_matrix: camera-to-world, shape [4, 4], rigid, metres.
        k1, k2: radial distortion (OpenCV: r → r (1 + k1 r² + k2 r⁴) on the plane z = −1).

    Raises:
        InputError: sizes or focal lengths not positive, or a matrix that is not a rigid motion.
    """

    name: str
    w: int
    h: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    transform_matrix: np.ndarray
    k1: float = 0.0
    k2: float = 0.0

    def __post_init__(self) -> None:
        matrix = np.array(self.transform_matrix, dtype=np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise InputError(f"transform_matrix of camera {self.name!r}: expected a finite 4×4 matrix")
        rotation = matrix[:3, :3]
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
            raise InputError(
                f"transform_matrix of camera {self.name!r}: its upper left 3×3 block is no rotation; expected "
                "camera-to-world with OpenGL axes (x right, y up, looking along −z), without scale"
            )
        if min(self.w, self.h, self.fl_x, self.fl_y) <= 0:
            raise InputError(f"camera {self.name!r}: w, h, fl_x and fl_y must be positive")
        matrix.setflags(write=False)
        object.__setattr__(self, "transform_matrix", matrix)

    @property
    def position(self) -> Float[np.ndarray, " 3"]:
        """Position of the camera [m]."""
        return self.transform_matrix[:3, 3]

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Camera-to-world rotation; the columns are the camera's right, up and backward axes."""
        return self.transform_matrix[:3, :3]

    def local(self, points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """World points [m] along the camera's right, up and backward axes, relative to its position [m]."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.position) @ self.rotation)

    def world(self, local: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """World points [m] of such coordinates."""
        return np.asarray(local @ self.rotation.T + self.position)

    def project(
        self, points: Float[np.ndarray, "... 3"]
    ) -> tuple[Float[np.ndarray, "... 2"], Float[np.ndarray, " ..."]]:
        """Pixel coordinates and depth [m] of world points [m].

        Depth is the distance along the viewing direction; it is ≤ 0 behind the camera, where the pixel
        coordinates are NaN.
        """
        local = self.local(points)
        depth = np.asarray(-local[..., 2])
        safe = np.where(depth > 0, depth, np.nan)
        x, y = local[..., 0] / safe, -local[..., 1] / safe
        scale = self.distortion(np.asarray(x**2 + y**2))
        return np.stack([self.fl_x * scale * x + self.cx, self.fl_y * scale * y + self.cy], axis=-1), depth

    def distortion(self, squared_radius: np.ndarray) -> np.ndarray:
        """Distortion factor of an undistorted radius on the plane z = −1."""
        return np.asarray(1.0 + squared_radius * (self.k1 + squared_radius * self.k2))

    def rays(
        self, pixels: Float[np.ndarray, "... 2"] | None = None
    ) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "... 3"]]:
        """Origin [m] and unit directions of the rays through pixels (default: all pixel centres, [h, w, 3])."""
        if pixels is None:
            columns, rows = np.meshgrid(np.arange(self.w) + 0.5, np.arange(self.h) + 0.5)
            pixels = np.stack([columns, rows], axis=-1)
        pixels = np.asarray(pixels, dtype=np.float64)
        distorted = (pixels - [self.cx, self.cy]) / [self.fl_x, self.fl_y]
        plane = distorted
        if self.k1 or self.k2:
            for _ in range(UNDISTORT_ITERATIONS):
                plane = distorted / self.distortion((plane**2).sum(-1, keepdims=True))
        local = np.concatenate([plane * [1, -1], -np.ones_like(plane[..., :1])], axis=-1)
        world = local @ self.rotation.T
        return self.position, world / np.linalg.norm(world, axis=-1, keepdims=True)

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with another number of pixels over the same field of view."""
        sx, sy = width / self.w, height / self.h
        return replace(
            self, w=width, h=height, fl_x=self.fl_x * sx, fl_y=self.fl_y * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def to_json(self) -> dict[str, JsonValue]:
        """The camera as an entry of `capture.json` (nerfstudio names)."""
        entry: dict[str, JsonValue] = {
            "name": self.name, "w": int(self.w), "h": int(self.h),
            "fl_x": float(self.fl_x), "fl_y": float(self.fl_y), "cx": float(self.cx), "cy": float(self.cy),
        }  # fmt: skip
        if self.k1 or self.k2:
            entry |= {"k1": float(self.k1), "k2": float(self.k2)}
        return entry | {"transform_matrix": self.transform_matrix.tolist()}

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> Camera:
        """Read an entry written by `to_json` (or by nerfstudio, with a name added).

        Raises:
            InputError: a field is missing or has the wrong type.
        """
        try:
            return cls.of_entry(CameraEntry.model_validate(entry))
        except ValidationError as error:
            wrong = list(dict.fromkeys(str(place["loc"][0]) for place in error.errors()))
        missing = [name for name in wrong if name not in entry]
        told = [f"missing {', '.join(missing)}"] if missing else []
        told += [f"{name}: {in_words(CameraEntry, name, entry)}" for name in wrong if name in entry]
        raise InputError(f"camera {entry.get('name', '(unnamed)')!r}: {'; '.join(told)}")

    @classmethod
    def of_entry(cls, entry: CameraEntry) -> Camera:
        """The camera of an entry.

        Raises:
            InputError: the matrix is not a rigid motion.
        """
        return cls(**dict(entry))


def look_at(
    eye: Vector,
    target: Vector,
    *,
    width: int,
    height: int,
    vertical_field_of_view: float,
    up: Vector = (0.0, 0.0, 1.0),
    name: str = "front",
) -> Camera:
    """Camera at `eye` [m] whose centre sees `target` [m], with square pixels.

    Args:
        vertical_field_of_view: full angle over the image height [rad].
        up: direction that appears upward in the image.

    Raises:
        InputError: eye and target coincide, or up is parallel to the viewing direction.
    """
    backward = np.asarray(eye, dtype=np.float64) - np.asarray(target, dtype=np.float64)
    right = np.cross(np.asarray(up, dtype=np.float64), backward)
    if np.linalg.norm(backward) == 0 or np.linalg.norm(right) < 1e-9 * np.linalg.norm(backward):
        raise InputError(f"look_at: eye {eye} and target {target} leave no image plane with up {up}")
    if not 0 < vertical_field_of_view < np.pi:
        raise InputError(f"vertical_field_of_view: got {vertical_field_of_view}; expected 0 to π rad")
    backward /= np.linalg.norm(backward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, np.cross(backward, right), backward, eye])
    focal = 0.5 * height / np.tan(0.5 * vertical_field_of_view)
    return Camera(name, width, height, focal, focal, width / 2, height / 2, matrix)
