"""Pictures of a played object over its floor, rendered by VTK without a display."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from physconvex.io import Picture, html_summary, load_triton_first
from physconvex.play.config import FloorConfig
from physconvex.play.roll_out import PlayedObject

_OBJECTS = ("#d8743c", "#3c7ad8", "#4f9d69", "#b5539c", "#d8b13c")
_LIGHT, _DARK = "#e9e6df", "#c9c4b8"
_SHOWN = 5  # frames in a notebook
_TILES = 24  # tiles along the floor, twice as wide as its visible part


def floor_displacement(floor: FloorConfig, time: float) -> Float[np.ndarray, " 3"]:
    """Displacement of the floor since t = 0 [m]: with constant velocity, or as the integral of its sine."""
    velocity = np.asarray(floor.velocity)
    if floor.period is None:
        return velocity * time
    turns = 2 * np.pi / floor.period
    return velocity * (1 - np.cos(turns * time)) / turns


def _floor(center: np.ndarray, tile: float, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [P, 3], quads [F, 4] and their shade [F] of a chequered floor moved by `shift`."""
    corner = np.floor((center[:2] - shift[:2]) / tile) - _TILES // 2
    axis = np.arange(_TILES + 1)
    x, y = np.meshgrid((corner[0] + axis) * tile + shift[0], (corner[1] + axis) * tile + shift[1], indexing="ij")
    number = np.arange(x.size).reshape(x.shape)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    shade = (corner.sum() + axis[:-1, None] + axis[:-1]).ravel() % 2
    return np.stack([x, y, np.full_like(x, shift[2])], axis=-1).reshape(-1, 3), quads, shade


class _Bodies:
    """The objects' surfaces in a picture, each in its colour."""

    def __init__(self, plotter: Any, played: PlayedObject) -> None:
        import pyvista

        self.played = played
        self.parts = []
        for number in range(len(played.trajectories)):
            rows = np.flatnonzero(played.owners == number)
            faces = played.surface.faces[(played.owners[played.surface.faces] == number).all(1)] - rows[0]
            part = pyvista.PolyData.from_regular_faces(played.positions[0][rows], faces)
            self._shade(part)
            actor = plotter.add_mesh(part, color=_OBJECTS[number % len(_OBJECTS)], specular=0.2)
            actor.prop.interpolation = "phong"
            self.parts.append((rows, part))

    def show(self, frame: int) -> None:
        """Move them to where they are at a frame."""
        for rows, part in self.parts:
            part.points = self.played.positions[frame][rows]
            self._shade(part)

    @staticmethod
    def _shade(part: Any) -> None:
        part.clear_data()  # VTK keeps existing normals
        part.compute_normals(inplace=True, split_vertices=False, auto_orient_normals=False, consistent_normals=False)


def frames_of(
    played: PlayedObject, *, size: int = 448, show: list[int] | None = None
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """RGB pictures from a fixed camera a little above the floor.

    Args:
        played: the object in motion.
        size: width and height [px], even.
        show: numbers of the frames; all unless given.
    """
    import pyvista

    load_triton_first()
    eye, center, reach = played.viewpoint()
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[size, size], lighting="three lights")
    try:
        plotter.set_background("white")
        plotter.camera.position = tuple(eye)
        plotter.camera.focal_point, plotter.camera.up = tuple(center), (0.0, 0.0, 1.0)
        plotter.camera.view_angle = 30.0
        bodies = _Bodies(plotter, played)
        floor, ground = played.config.floor, None
        tile = float(np.ptp(played.positions[0], axis=0).max()) / 3
        for number in range(len(played.positions)) if show is None else show:
            bodies.show(number)
            if floor is not None:
                shift = floor_displacement(floor, float(played.trajectory.times[number]))
                points, quads, shade = _floor(center, tile, shift)
                plotter.remove_actor(ground, render=False)
                plane = pyvista.PolyData.from_regular_faces(points, quads)
                plane.cell_data["shade"] = shade
                ground = plotter.add_mesh(
                    plane, scalars="shade", cmap=[_LIGHT, _DARK], show_scalar_bar=False, lighting=False
                )
            plotter.camera.clipping_range = (0.01 * reach, 100 * reach)
            yield np.ascontiguousarray(plotter.screenshot(return_img=True))
    finally:
        plotter.close()


def played_html(played: PlayedObject) -> str:
    """Numbers, and the objects from the side at some frames."""
    heights, times = played.positions[:, :, 2], played.trajectory.times
    rows = [
        ("objects, mass, volume", f"{len(played.masses)}, {played.mass:.3g} kg, {played.volume:.3g} m³"),
        ("frames", f"{len(times)}, {times[-1]:.3g} s"),
        ("height, first and last", f"{np.ptp(heights[0]):.3g} m, {np.ptp(heights[-1]):.3g} m"),
        ("lowest point", f"{heights.min():.3g} m"),
    ]
    return html_summary("Simulation", rows, pictures=[Picture(_side_views(played), "the motion from the side")])


def _side_views(played: PlayedObject) -> bytes:
    """PNG of some frames, viewed along y, drawn by matplotlib, which needs no OpenGL."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    faces, owners = played.surface.faces, played.owners[played.surface.faces[:, 0]]
    shown = np.unique(np.linspace(0, len(played.positions) - 1, _SHOWN).round().astype(int))
    figure = Figure(figsize=(2 * len(shown), 2.2), layout="constrained")
    low, high = played.positions[..., [0, 2]].min((0, 1)), played.positions[..., [0, 2]].max((0, 1))
    for axes, frame in zip(np.atleast_1d(figure.subplots(1, len(shown), sharey=True)), shown, strict=True):
        corners = played.positions[frame][faces]
        order = np.argsort(-corners[:, :, 1].mean(1))  # the farthest first
        colours = [_OBJECTS[k % len(_OBJECTS)] for k in owners[order]]
        outlines = corners[order][:, :, [0, 2]]
        axes.add_collection(PolyCollection(outlines, facecolors=colours, edgecolors="#0003", lw=0.2))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]")
        axes.set_title(f"{played.trajectory.times[frame]:.2f} s", fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90)
    return buffer.getvalue()
