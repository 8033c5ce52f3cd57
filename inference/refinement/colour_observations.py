"""Colour residuals beside the others: the first image carried by the fitted model, from a wide blur to a narrow one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from inference.refinement.observations import Observed
from inference.refinement.options import RefineOptions
from inference.refinement.problem import Problem
from physconvex import InputError
from physconvex.identify import (
    ColourObservations,
    Fit,
    FullModel,
    Observations,
    PixelObservations,
    ReducedModel,
    StackedObservations,
    Twin,
    blurred,
    colour_seeds,
    seen_by,
)
from physconvex.io import Capture

__all__ = ["WIDE", "blur_for", "coloured", "in_pixels"]

_NARROW = 1.5  # pixels
WIDE = 6.0  # pixels: tells from afar which rebound is the nearest


def blur_for(problem: Problem) -> float:
    """The blur [pixels], to the half, over which colours tell the body from where its model is known to put it.

    As wide as the model is astray in the images of the nearest camera: what a narrower one compares lies elsewhere.
    """
    return float(np.clip(round(2 * in_pixels(problem, problem.astray)) / 2, _NARROW, WIDE))


def in_pixels(problem: Problem, length: float) -> float:
    """A length [m] where the body begins, in the images of the nearest camera."""
    centre = problem.twin.mesh.vertices.mean(axis=0)
    return length * float(max(camera.fl_x / camera.project(centre)[1] for camera in problem.observed.cameras))


def coloured(
    observed: Observed,
    capture: Capture,
    twin: Twin,
    model: FullModel | ReducedModel,
    found: Fit,
    options: RefineOptions,
    blur: float,
) -> Observed:
    """What was observed, with the colours of surface points in the place of the points followed.

    Which points are seen where is taken from the fitted model. A camera that sees none keeps its followed points.
    """
    vertices, triangles = twin.surface
    parts: list[Observations] = []
    sources = []
    for part, source in zip(observed.observations.parts, observed.sources, strict=True):
        added = None
        if isinstance(part, PixelObservations):
            images = capture.video(part.camera.name).frames[: len(part.pixels)]
            masks = capture.mask(part.camera.name)
            mask = None if masks is None else masks[0] > 0
            margin = round(2 * blur)
            seeds = colour_seeds(part.camera, images[0], vertices, triangles, mask=mask, margin=margin)
            points = seeds.on(vertices, triangles)
            if len(points):
                everything = np.concatenate([vertices, points])
                moved = replace(model, points=everything).positions(found.values)
                surface, carried = moved[:, : len(vertices)], moved[:, len(vertices) :]
                visible = seen_by(part.camera, surface, triangles, carried, seeds.faces, margin=margin)
                added = _colours(part, points, blurred(images, blur), visible, options)
        parts.append(part if added is None else added)
        sources.append(
            source if added is None else f"camera {added.camera.name}: colours of {len(added.points)} points"
        )
    return replace(observed, observations=StackedObservations.of(parts), sources=tuple(sources))


def _colours(
    part: PixelObservations, points: np.ndarray, images: np.ndarray, visible: np.ndarray, options: RefineOptions
) -> ColourObservations | None:
    try:
        return ColourObservations(part.camera, points, images, visible, exposure=options.exposure)
    except InputError:  # nothing is seen again
        return None
