"""Convex dynamics of a refinement: the field is split for the fitted motion, if the videos are then drawn better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from inference.refinement.appearance import Appearance, FieldSplit
from physconvex.convex import adapt_to_motion, bent_frames, tet_map
from physconvex.io import Camera, Capture
from physconvex.reconstruction import psnr

_DISTANCE = 0.5  # of a pixel: a convex that is nearer to an affine motion stays whole
_GROWTH, _LEAST = 1.25, 4000  # most convexes after splitting: times those given, and at least
_COMPARED = 5  # observed frames


def with_split_convexes(appearance: Appearance, capture: Capture) -> Appearance:
    """The appearance with convexes split where the motion bends them, unless the observed videos are then drawn worse.

    Without a video with masks nothing can be compared, and nothing is split.
    """
    cameras = [c for c in capture.filmed if capture.mask(c.name) is not None]
    if not cameras:
        return appearance
    mesh, nodes = appearance.motion.mesh, appearance.motion.nodes
    middle = mesh.vertices.mean(axis=0)
    pixel = min(float(np.linalg.norm(np.asarray(c.position) - middle)) / c.fl_y for c in cameras)
    distance, count = _DISTANCE * pixel, len(appearance.field)
    frames = bent_frames(mesh.vertices, nodes, distance=distance)
    limit = max(round(_GROWTH * count), _LEAST)
    found = adapt_to_motion(appearance.field, tet_map(mesh, nodes[frames]), distance=distance, limit=limit)
    gain, changed = 0.0, replace(appearance, field=found.field)
    if found.split > found.given:
        gain = _psnr(changed, capture, cameras) - _psnr(appearance, capture, cameras)
    told = FieldSplit(found, gain)
    return replace(changed if told.used else appearance, split=told)


def _psnr(appearance: Appearance, capture: Capture, cameras: Sequence[Camera]) -> float:
    """Of the object's pixels in some of the observed frames [dB]."""
    drawn, seen = [], []
    for camera in cameras:
        frames, masks = capture.video(camera.name).frames, capture.mask(camera.name)
        assert masks is not None
        for frame in np.unique(np.linspace(0, capture.observed_frames - 1, _COMPARED).round().astype(int)):
            picture, _ = appearance.image(int(frame), camera)
            drawn.append(picture[masks[frame]])
            seen.append(frames[frame][masks[frame]])
    pictures = (torch.as_tensor(np.concatenate(part)).float() / 255 for part in (drawn, seen))
    return psnr(*pictures)
