"""Scores of a moving field against the images of every camera."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8

from physconvex.convex import ConvexField
from physconvex.io import Camera, read_video
from physconvex.reconstruction import psnr, structural_similarity
from physconvex.render import render
from train.paper.rows import PictureScores


def score_pictures(
    fields: Sequence[ConvexField], cameras: Sequence[Camera], truth: Path, frames: range
) -> dict[str, PictureScores]:
    """Scores by view ("front", the first camera; "others"), means over frames.

    Args:
        fields: in those frames.
        cameras: the front one first.
        truth: folder with `<camera>.mp4` before white.
        frames: which.
    """
    out = {}
    for label, chosen in (("front", cameras[:1]), ("others", cameras[1:])):
        rows, quality = [], None
        for camera in chosen:
            seen = read_video(truth / f"{camera.name}.mp4").frames[frames.start : frames.stop]
            drawn = list(_drawn(fields, camera))
            rows += [_row(image, reference) for image, reference in zip(drawn, seen, strict=True)]
            if label == "front":
                quality = perceptual_score(np.stack(drawn), seen)
        if rows:
            similarity = [float(mean) for mean in np.mean(rows, axis=0)]
            out[label] = PictureScores(
                psnr=similarity[0], ssim=similarity[1], psnr_object=similarity[2], fovvdp=quality
            )
    return out


@torch.no_grad()
def _drawn(fields: Sequence[ConvexField], camera: Camera) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    for field in fields:
        colour = render(field, camera, background=torch.ones(3)).colour
        yield (255 * colour.clamp(0, 1)).round().to(torch.uint8).numpy()


def _row(image: np.ndarray, reference: np.ndarray) -> tuple[float, float, float]:
    a, b = (torch.as_tensor(x.astype(np.float32) / 255) for x in (image, reference))
    inside = ((a < 0.98) | (b < 0.98)).any(-1)
    return psnr(a, b), float(structural_similarity(a, b)), psnr(a[inside], b[inside])


def perceptual_score(images: UInt8[np.ndarray, "T H W 3"], references: UInt8[np.ndarray, "T H W 3"]) -> float | None:
    """FovVideoVDP [JOD] on a standard 4K display, 24 frames per second; None where `pyfvvdp` (CC BY-NC) is absent."""
    if importlib.util.find_spec("pyfvvdp") is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it uses deprecated functions of SciPy
        import pyfvvdp

        metric: Any = pyfvvdp.fvvdp(display_name="standard_4k", heatmap=None)
    quality, _ = metric.predict(images, references, dim_order="FHWC", frames_per_second=24.0)
    return float(quality)
