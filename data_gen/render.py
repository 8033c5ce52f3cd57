"""Images of a deforming textured surface over a floor, rendered by VTK without a display.

Each frame is a static plate (floor and background), darkened by the object's shadow, under the lit object. The
shadow is the surface projected on the floor along the key light, rendered from the same camera and softened. All
passes are super-sampled and averaged; the object's coverage of each pixel is the mask.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.surface import Backdrop, DrawnSurface, Lighting, corner_normals
from data_gen.vtk_passes import (
    light_object,
    object_pass,
    open_window,
    place_camera,
    plate_pass,
    shadow_pass,
)
from physconvex import InputError
from physconvex.io import Camera

if TYPE_CHECKING:
    from vtkmodules.vtkRenderingCore import vtkRenderer


class Renderer:
    """Off-screen renderer of a fixed image size; reuse one per process.

    Call `set_surface`, then `set_view`, then `frame` for each set of vertex positions.

    Raises:
        RenderError: no OpenGL context can be made.
    """

    def __init__(self, width: int, height: int, *, supersampling: int = 2) -> None:
        self.width, self.height, self.factor = width, height, supersampling
        self.window = open_window(width * supersampling, height * supersampling)
        self.passes: dict[str, Any] = {}
        self.surface: DrawnSurface | None = None
        self.plate: np.ndarray | None = None

    def set_surface(self, surface: DrawnSurface) -> None:
        """Choose the object that is drawn from now on."""
        import pyvista as pv

        self.release_passes("object", "shadow")
        self.surface = surface
        self.normals = corner_normals(surface.vertices, surface.faces)
        self.corners = surface.faces.ravel()
        points = surface.vertices.astype(np.float32)
        apart = np.arange(len(self.corners)).reshape(-1, 3)
        self.mesh: Any = pv.PolyData.from_regular_faces(points[self.corners], apart)
        self.mesh.point_data["Normals"] = np.zeros((len(self.corners), 3), np.float32)
        self.mesh.GetPointData().SetActiveNormals("Normals")
        self.flat: Any = pv.PolyData.from_regular_faces(points, surface.faces)
        self.add_pass("object", object_pass(self.mesh, surface))
        self.add_pass("shadow", shadow_pass(self.flat))

    def set_view(self, camera: Camera, lighting: Lighting, backdrop: Backdrop) -> None:
        """Choose camera, light and surroundings; renders the static plate once."""
        if self.surface is None:
            raise InputError("set_view: no surface yet; call set_surface before")
        if (camera.w, camera.h) != (self.width, self.height):
            raise InputError(f"camera: {camera.w}×{camera.h} pixels; this renderer makes {self.width}×{self.height}")
        if camera.k1 or camera.k2:
            raise InputError("camera: k1 and k2 must be zero, since the renderer makes undistorted images")
        self.camera, self.lighting = camera, lighting
        self.release_passes("plate")
        self.add_pass("plate", plate_pass(backdrop))
        for renderer in self.passes.values():
            place_camera(renderer, camera)
        light_object(self.passes["object"], lighting, camera)
        floor_light = lighting.ambient + lighting.fill * 0.5 + lighting.key * lighting.direction[2]
        self.shadow_strength = lighting.key * lighting.direction[2] / floor_light
        self.plate = self.draw("plate")[..., :3]

    def frame(self, positions: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
        """Image (0 to 1) and coverage by the object (0 to 1) with the surface's vertices at `positions` [m]."""
        rgba = self.object_alone(positions)
        assert self.plate is not None  # else the line above has raised
        towards = np.array(self.lighting.direction)
        self.flat.points[:] = positions - np.maximum(positions[:, 2:], 0) / towards[2] * towards
        self.flat.Modified()
        shadow, sigma = self.draw("shadow")[..., 3], self.lighting.shadow_softness * self.height
        shadow = cv2.GaussianBlur(shadow, (0, 0), sigma) if sigma > 0.2 else shadow
        image = self.plate * (1 - self.shadow_strength * shadow[..., None])
        image = image * (1 - rgba[..., 3:]) + rgba[..., :3]
        return image, rgba[..., 3]

    def object_alone(self, positions: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "h w 4"]:
        """The lit object without floor and background, vertices at `positions` [m]; pre-multiplied RGBA, 0 to 1."""
        if self.plate is None or self.surface is None:
            raise InputError("frame: no view yet; call set_surface and set_view before")
        corners = positions[self.corners]
        self.mesh.points[:] = corners
        self.mesh.point_data["Normals"][:] = self.normals.at(corners.reshape(-1, 3, 3))
        self.mesh.Modified()
        return self.draw("object")

    def draw(self, name: str) -> Float[np.ndarray, "h w 4"]:
        """Render one pass alone; pre-multiplied RGBA averaged over the super-samples."""
        from vtkmodules.vtkCommonCore import vtkUnsignedCharArray

        for key, renderer in self.passes.items():
            renderer.SetDraw(key == name)
        self.window.Render()
        wide, tall = self.width * self.factor, self.height * self.factor
        pixels: Any = vtkUnsignedCharArray()
        self.window.GetRGBACharPixelData(0, 0, wide - 1, tall - 1, 0, pixels)
        image = np.asarray(memoryview(pixels)).reshape(tall, wide, 4)[::-1]
        blocks = image.reshape(self.height, self.factor, self.width, self.factor, 4)
        return blocks.mean(axis=(1, 3), dtype=np.float32) / np.float32(255)

    def add_pass(self, name: str, renderer: vtkRenderer) -> None:
        self.passes[name] = renderer
        self.window.AddRenderer(renderer)

    def release_passes(self, *names: str) -> None:
        """Drop passes and their graphics memory."""
        for name in names:
            renderer = self.passes.pop(name, None)
            if renderer is not None:
                renderer.ReleaseGraphicsResources(self.window)
                self.window.RemoveRenderer(renderer)

    def close(self) -> None:
        """Give the graphics context back."""
        self.release_passes(*list(self.passes))
        self.window.Finalize()
