"""Displacement of a surface to the outlines of the pictures, to a fraction of a pixel.

Every silhouette tells the place of the surface along its outline. There, the distance to the picture's silhouette less
that to the surface's own, both taken at the same pixel, is the missing displacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float
from scipy.ndimage import map_coordinates

from physconvex.reconstruction.observation import Observation

FINE = 4  # parts of a pixel's edge, in which the surface's own silhouette is drawn
NEAR = 1.5  # pixels from its own outline
ACROSS = 0.4  # greatest cosine between normal and ray, on an outline
REACH = 1.5  # cells: outlines farther apart are of different parts


def outline_displacements(
    surface: trimesh.Trimesh,
    observations: Sequence[Observation],
    cosines: Float[np.ndarray, "V C"],
    *,
    cell: float,
) -> tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]]:
    """Outward displacement [m] of each vertex to the outlines of the pictures, and on how many outlines it is.

    Args:
        surface: closed, outward oriented [m].
        observations: the views.
        cosines: between normal and ray to each camera, NaN if hidden.
        cell: accuracy of the surface [m].
    """
    total, count = np.zeros(len(cosines)), np.zeros(len(cosines))
    for cosine, seen in zip(cosines.T, observations, strict=True):
        missing, near = _missing(surface, seen)
        there = near & (np.abs(cosine) < ACROSS) & (np.abs(missing) < REACH * cell)
        total[there] += missing[there]
        count[there] += 1.0
    return total / np.maximum(count, 1.0), count


def _missing(surface: trimesh.Trimesh, seen: Observation) -> tuple[Float[np.ndarray, " V"], Bool[np.ndarray, " V"]]:
    """Outward displacement [m] of each vertex to the picture's outline, and whether it is on the surface's own."""
    camera = seen.camera
    pixels, depth = camera.project(np.asarray(surface.vertices))
    own = replace(seen, coverage=torch.as_tensor(_coverage(pixels[surface.faces], camera.h, camera.w)))
    place = (np.nan_to_num(pixels) - 0.5).T[::-1]
    there, here = (map_coordinates(one.edge_distance, place, order=1, mode="nearest") for one in (seen, own))
    return (here - there) * depth / np.sqrt(camera.fl_x * camera.fl_y), np.abs(here) < NEAR


def _coverage(triangles: Float[np.ndarray, "F 3 2"], height: int, width: int) -> Float[np.ndarray, "H W"]:
    """Share of each pixel that triangles in pixel coordinates cover."""
    drawn = np.zeros((FINE * height, FINE * width), np.uint8)
    for corners in np.round((FINE * np.nan_to_num(triangles) - 0.5) * 16).astype(np.int32):  # in sixteenths
        cv2.fillConvexPoly(drawn, corners, 1, lineType=cv2.LINE_8, shift=4)
    return np.asarray(cv2.resize(drawn.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA))
