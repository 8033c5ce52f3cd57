"""VTK objects of each pass: window, actors, lights, and a camera with exact intrinsics."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, cast

import numpy as np
from jaxtyping import Float

from data_gen.surface import Backdrop, DrawnSurface, Lighting
from physconvex import PhysconvexError
from physconvex.io import Camera, load_triton_first

if TYPE_CHECKING:
    from pyvista import PolyData, Texture
    from vtkmodules.vtkRenderingCore import vtkActor, vtkLight, vtkRenderer, vtkRenderWindow

FLOOR_EXTENT = 40.0  # half edge of the floor [m]
DOME_RADIUS = 60.0  # of the background [m], so that it starts where the floor ends
DOME_FOOT = -5.0  # lower end of the background [m], below the floor so that no gap is seen
CLIP_RANGE = (0.02, 250.0)  # [m]
REMEDY = (
    "on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri (software rendering, no display needed); "
    "with an NVIDIA driver libegl1 is enough"
)


class RenderError(PhysconvexError, RuntimeError):
    """No image can be rendered on this machine; the message says what to install."""


@contextmanager
def without_display() -> Iterator[None]:
    """Ask VTK for EGL and keep its notes on a missing X server off the terminal."""
    from vtkmodules.vtkCommonCore import vtkLogger

    chosen = os.environ.get("VTK_DEFAULT_OPENGL_WINDOW")
    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = chosen or "vtkEGLRenderWindow"
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
        if chosen is None:
            del os.environ["VTK_DEFAULT_OPENGL_WINDOW"]


def open_window(width: int, height: int) -> vtkRenderWindow:
    """An off-screen window with an alpha channel.

    Raises:
        RenderError: no OpenGL context can be made here.
    """
    load_triton_first()
    with without_display():
        import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (registers VTK's OpenGL classes)
        from vtkmodules.vtkRenderingCore import vtkRenderWindow

        window = vtkRenderWindow()
        # VTK falls back to OSMesa, and crashes at the first image where that is not installed either.
        if window.GetClassName() == "vtkOSOpenGLRenderWindow" and ctypes.util.find_library("OSMesa") is None:
            raise RenderError(f"no OpenGL: neither EGL nor OSMesa could be loaded; {REMEDY}")
        window.SetOffScreenRendering(True)
        window.SetMultiSamples(0)
        window.SetAlphaBitPlanes(1)
        window.SetSize(width, height)
        window.Initialize()
        if not window.SupportsOpenGL():
            raise RenderError(f"no usable OpenGL: {window.GetClassName()}; {REMEDY}")
    return window


def new_renderer(*actors: vtkActor) -> vtkRenderer:
    """A renderer on a transparent background, without automatic lights or cameras."""
    from vtkmodules.vtkRenderingCore import vtkRenderer

    renderer = vtkRenderer()
    renderer.SetBackground(0.0, 0.0, 0.0)
    renderer.SetBackgroundAlpha(0.0)
    renderer.AutomaticLightCreationOff()
    renderer.GetActiveCamera()
    for actor in actors:
        renderer.AddActor(actor)
    return renderer


def new_actor(mesh: PolyData) -> vtkActor:
    from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

    mapper = vtkPolyDataMapper()
    mapper.SetInputDataObject(mesh)
    mapper.ScalarVisibilityOff()
    actor = vtkActor()
    actor.SetMapper(mapper)
    return actor


def unlit(actor: vtkActor, brightness: float = 1.0) -> vtkActor:
    properties = actor.GetProperty()
    properties.LightingOff()
    properties.SetColor(brightness, brightness, brightness)
    return actor


def image_texture(image: np.ndarray, *, mirrored: bool) -> Texture:
    """Smoothly filtered texture of an image whose row 0 is up; repeated, every other time `mirrored` (no seams)."""
    import pyvista as pv
    from vtkmodules.vtkRenderingCore import vtkTexture

    texture = pv.Texture(np.ascontiguousarray(image))
    texture.SetWrap(vtkTexture.MirroredRepeat if mirrored else vtkTexture.Repeat)
    texture.InterpolateOn()
    texture.MipmapOn()
    texture.SetMaximumAnisotropicFiltering(8)
    return texture


def object_pass(mesh: PolyData, surface: DrawnSurface) -> vtkRenderer:
    """The lit object alone; `mesh` has three own points per face of `surface`."""
    from vtkmodules.vtkRenderingCore import vtkLight

    actor = new_actor(mesh)
    corners = surface.faces.ravel()
    if surface.texture is not None and surface.uv is not None:
        mesh.active_texture_coordinates = surface.uv[corners].astype(np.float32)
        actor.SetTexture(image_texture(surface.texture, mirrored=False))
    else:
        assert surface.colors is not None
        mesh.point_data["rgb"] = surface.colors[corners]
        mesh.GetPointData().SetActiveScalars("rgb")
        actor.GetMapper().ScalarVisibilityOn()
        actor.GetMapper().SetColorModeToDirectScalars()
    actor.GetProperty().SetInterpolationToPhong()
    renderer = new_renderer(actor)
    for _ in range(3):
        light = vtkLight()
        light.SetLightTypeToSceneLight()
        light.PositionalOff()
        renderer.AddLight(light)
    return renderer


def shadow_pass(mesh: PolyData) -> vtkRenderer:
    """The flattened object in white."""
    return new_renderer(unlit(new_actor(mesh)))


def plate_pass(backdrop: Backdrop) -> vtkRenderer:
    """Floor and background, as they look without the object."""
    import pyvista as pv

    square: np.ndarray = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    floor = pv.PolyData.from_regular_faces(FLOOR_EXTENT * square, np.array([[0, 1, 2, 3]]))
    floor.active_texture_coordinates = (FLOOR_EXTENT / backdrop.floor_tile * square[:, :2]).astype(np.float32)
    floor_actor = unlit(new_actor(floor))
    floor_actor.SetTexture(image_texture(backdrop.floor, mirrored=True))
    dome_actor = unlit(new_actor(dome()))
    dome_actor.SetTexture(image_texture(backdrop.background, mirrored=True))
    return new_renderer(floor_actor, dome_actor)


def dome(steps: int = 64) -> PolyData:
    """Open cylinder around the scene; the picture runs four times around it, every other time mirrored."""
    import pyvista as pv

    angle = np.linspace(0, 2 * np.pi, steps + 1)
    circle = DOME_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
    rows = [(DOME_FOOT, 0.0), (0.0, 0.0), (0.8 * DOME_RADIUS, 1.0)]
    points = np.vstack([np.column_stack([circle, np.full(len(circle), z)]) for z, _ in rows])
    picture = [np.column_stack([2 * angle / np.pi, np.full(len(angle), v)]) for _, v in rows]
    coordinates: np.ndarray = np.vstack(picture).astype(np.float32)
    first = np.arange(steps)
    n = steps + 1
    quads = [np.column_stack([first, first + 1, first + 1 + n, first + n]) + k * n for k in range(len(rows) - 1)]
    mesh = pv.PolyData.from_regular_faces(points.astype(np.float32), np.vstack(quads))
    mesh.active_texture_coordinates = coordinates
    return mesh


def light_object(renderer: vtkRenderer, lighting: Lighting, camera: Camera) -> None:
    """Set the key, fill and upward bounce lights and the material of the object pass."""
    lights = [cast("vtkLight", renderer.GetLights().GetItemAsObject(k)) for k in range(3)]
    key = np.array(lighting.direction)
    viewer = camera.position / np.linalg.norm(camera.position)
    fill = viewer - 0.8 * key + [0, 0, 0.3]
    directions = (key, fill / np.linalg.norm(fill), np.array([0.0, 0.0, -1.0]))
    intensities = (lighting.key, lighting.fill, lighting.bounce * lighting.ambient)
    for light, direction, intensity in zip(lights, directions, intensities, strict=True):
        light.SetPosition(*(100 * direction))
        light.SetFocalPoint(0, 0, 0)
        light.SetIntensity(intensity)
    lights[0].SetColor(*lighting.color)
    actor = cast("vtkActor", renderer.GetActors().GetItemAsObject(0))
    properties = actor.GetProperty()
    properties.SetAmbient(lighting.ambient)
    properties.SetDiffuse(1.0)
    properties.SetSpecular(lighting.specular)
    properties.SetSpecularPower(25.0)


def place_camera(renderer: vtkRenderer, camera: Camera) -> None:
    """Give a renderer the pose and the exact intrinsics of a camera."""
    from vtkmodules.vtkCommonMath import vtkMatrix4x4

    vtk_camera = renderer.GetActiveCamera()
    vtk_camera.SetPosition(*camera.position)
    vtk_camera.SetFocalPoint(*(camera.position - camera.rotation[:, 2]))
    vtk_camera.SetViewUp(*camera.rotation[:, 1])
    vtk_camera.SetClippingRange(*CLIP_RANGE)
    matrix = vtkMatrix4x4()
    matrix.DeepCopy(projection_matrix(camera).ravel().tolist())
    vtk_camera.SetExplicitProjectionTransformMatrix(matrix)
    vtk_camera.UseExplicitProjectionTransformMatrixOn()


def projection_matrix(camera: Camera) -> Float[np.ndarray, "4 4"]:
    """OpenGL projection (clip coordinates −1 to 1) of a camera's intrinsics."""
    near, far = CLIP_RANGE
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2 * camera.fl_x / camera.w
    matrix[0, 2] = 1 - 2 * camera.cx / camera.w
    matrix[1, 1] = 2 * camera.fl_y / camera.h
    matrix[1, 2] = 2 * camera.cy / camera.h - 1
    matrix[2, 2] = -(far + near) / (far - near)
    matrix[2, 3] = -2 * far * near / (far - near)
    matrix[3, 2] = -1.0
    return matrix
