"""Scores of a moving field against what every camera saw."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8

from physconvex.convex import ConvexField, bind_to_tets
from physconvex.io import Camera, read_video
from physconvex.mesh import TetMesh
from physconvex.reconstruction import psnr, structural_similarity
from physconvex.render import render

__all__ = ["PictureScore", "perceptual_score", "score_pictures"]


@dataclass(frozen=True)
class PictureScore:
    """Means over the frames of a part of the motion, of the front view and of the others.

    Attributes:
        psnr, ssim: over whole images [dB], [-].
        psnr_object: over pixels that are not white in either image [dB].
        fovvdp: quality in JOD (Mantiuk et al. 2021) of the front view, where `pyfvvdp` is installed.
    """

    psnr: float
    ssim: float
    psnr_object: float
    fovvdp: float | None = None


def score_pictures(
    field: ConvexField,
    mesh: TetMesh,
    nodes: Float[np.ndarray, "T V 3"],
    cameras: Sequence[Camera],
    truth: Path,
    frames: range,
) -> dict[str, PictureScore]:
    """Scores by view ("front", the first camera; "others") in some frames.

    Args:
        field: at rest.
        mesh, nodes: the body that carries it, and its motion [m].
        cameras: the front one first.
        truth: folder with `<camera>.mp4` before white.
        frames: which.
    """
    bound = bind_to_tets(field, mesh)
    fields = [bound.at(nodes[t]) for t in frames]
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
            mean = np.mean(rows, axis=0)
            out[label] = PictureScore(float(mean[0]), float(mean[1]), float(mean[2]), quality)
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
        warnings.simplefilter("ignore")  # it uses what SciPy has deprecated
        import pyfvvdp

        metric: Any = pyfvvdp.fvvdp(display_name="standard_4k", heatmap=None)
    quality, _ = metric.predict(images, references, dim_order="FHWC", frames_per_second=24.0)
    return float(quality)
