"""The body's closed surface from a fitted field and the pictures.

Depths of the field are fused into a signed distance (Curless & Levoy 1996) within the visual hull; its zero level is
then moved to where the pictures agree (`photo_consistency`). What no picture shows is closed by a membrane.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float
from scipy.ndimage import binary_fill_holes, label, minimum_filter

from physconvex.convex import ConvexField
from physconvex.reconstruction.carving import cell_of, cube_lattice, hull_distance, object_box
from physconvex.reconstruction.hull_surface import level_surface
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.photo_consistency import colours_seen, moved_to_agreement, nearest_pixels
from physconvex.reconstruction.view_checks import nothing_in_common
from physconvex.render import render

REACH = 4.0  # cells behind a visible surface of which its depth still tells
OPAQUE = 0.5  # least alpha of a pixel with a depth
EVENED = 10  # steps of Taubin's filter on the fused surface
THICKER = 0.5  # cells by which a lost limb is, at first, so that it is in one piece
AGREEING = 3  # silhouettes that show a lost part
LOOSE = 0.05  # of the largest component's volume: smaller ones are not of the body


def closed_surface(
    field: ConvexField, observations: Sequence[Observation], *, cells: int | None = None
) -> trimesh.Trimesh:
    """Closed, outward oriented surface of the body [m], with a colour per vertex.

    Args:
        field: fitted to the observations, on the CPU.
        observations: the views, on the CPU.
        cells: of the lattice, along an edge of the cube around the object; default: one per two pixels, at most 128.

    Raises:
        InputError: no point in space projects into all masks.
    """
    centre, half = object_box(observations)
    if cells is None:
        cells = round(2 * half / cell_of(observations))
    lattice, cell = cube_lattice(centre, half, cells)
    hull = hull_distance(observations, lattice)
    if not (hull < 0).any():
        raise nothing_in_common(observations)
    near = np.nonzero(hull < 2 * cell)[0]
    distance = hull.copy()
    distance[near] = np.maximum(hull[near], _fused(field, observations, lattice[near], REACH * cell))
    shape = (cells + 1,) * 3
    lost = _unexplained(
        _counting(distance.reshape(shape) < 0).ravel(), hull < THICKER * cell, lattice, observations, cell
    )
    distance[lost] = hull[lost] - THICKER * cell
    distance = np.abs(distance.reshape(shape)) * np.where(_without_cavities(distance.reshape(shape) < 0), -1, 1)
    surface = level_surface(distance, origin=centre - half, cell=cell)
    surface = trimesh.smoothing.filter_taubin(surface, iterations=EVENED)
    surface = moved_to_agreement(surface, observations, cell=cell)
    surface.visual = trimesh.visual.ColorVisuals(surface, vertex_colors=colours_seen(surface, observations, cell=cell))
    return surface


def _fused(
    field: ConvexField, observations: Sequence[Observation], positions: Float[np.ndarray, "Q 3"], reach: float
) -> Float[np.ndarray, " Q"]:
    """Signed distance [m] from the surface that the depths of the field show, at most `reach`; −reach if none tells.

    The mean over the views of the depth less that of the position, weighted by the squared cosine between the ray and
    the surface's normal. A view tells nothing of what is farther than `reach` behind its surface.
    """
    total, weights = np.zeros(len(positions)), np.zeros(len(positions))
    for seen in observations:
        camera = seen.camera
        with torch.no_grad():
            image = render(field, camera)
        depth = np.where(image.alpha.numpy() > OPAQUE, image.depth.numpy(), np.nan).astype(np.float64)
        slope = np.hypot(*np.gradient(depth)) * np.sqrt(camera.fl_x * camera.fl_y) / depth
        cosine = np.nan_to_num(1 / (1 + slope**2))
        nearest = minimum_filter(np.nan_to_num(depth, nan=np.inf), size=3)
        place, depths = nearest_pixels(camera, positions)
        gap = depth[place] - depths
        # false where nothing is visible, and beside the outline of something in front
        tells = (gap > -reach) & ((gap < reach) | (nearest[place] - depths > reach))
        weight = np.where(tells, cosine[place], 0.0)
        total += weight * np.where(tells, np.minimum(gap, reach), 0.0)
        weights += weight
    return np.where(weights > 1e-3, total / np.maximum(weights, 1e-9), -reach)


def _counting(inside: Bool[np.ndarray, "n n n"]) -> Bool[np.ndarray, "n n n"]:
    """The largest connected region, and others of a size that counts."""
    regions, _ = label(inside, np.ones((3, 3, 3)))
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    return (sizes >= LOOSE * sizes.max())[regions] & inside


def _unexplained(
    body: Bool[np.ndarray, " Q"],
    hull: Bool[np.ndarray, " Q"],
    lattice: Float[np.ndarray, "Q 3"],
    observations: Sequence[Observation],
    cell: float,
) -> Bool[np.ndarray, " Q"]:
    """Points of the hull that show in parts of several silhouettes where the body does not: thin limbs it lost."""
    rest = np.nonzero(hull & ~body)[0]
    votes = np.zeros(len(rest), dtype=int)
    for seen in observations:
        camera = seen.camera
        place, depths = nearest_pixels(camera, lattice[body])
        shown = np.zeros((camera.h, camera.w), np.uint8)
        shown[place] = 1
        width = 2 * int(np.ceil(cell * camera.fl_x / depths.mean())) + 1
        covered = cv2.dilate(shown, np.ones((width, width), np.uint8)) > 0
        missing = (seen.coverage.numpy() > 0.5) & ~covered
        near = cv2.dilate(missing.astype(np.uint8), np.ones((width + 2, width + 2), np.uint8))
        votes += near[nearest_pixels(camera, lattice[rest])[0]]
    lost = np.zeros(len(lattice), dtype=bool)
    lost[rest] = votes >= AGREEING
    return lost


def _without_cavities(inside: Bool[np.ndarray, "n n n"]) -> Bool[np.ndarray, "n n n"]:
    """The regions that count, without cavities, which no picture shows."""
    return np.asarray(binary_fill_holes(_counting(inside)))
