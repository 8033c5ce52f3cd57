"""Gaussians fitted to views through the loop of the convexes: the same start, loss, steps, schedule and refinement.

The mesh's surface is covered with flat Gaussians as it is with prisms; each step draws one view, at a quarter, a half
and all of the pixels; loss and Adam are those of `physconvex.reconstruction`. Refinement charges each Gaussian with the
squared differences of the pixels that it explains, lets those go that explain least once the budget is full, and
splits (Kerbl et al. 2023, §5.2: two, drawn from the one, 1.6 times smaller) or clones those charged most. Only the
rates are the Gaussians' own; see `Rates`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from gaussians import Gaussians, blend_gaussians, quaternions_of, render_gaussians, rotation_matrices
from torch import Tensor

from physconvex.convex import coefficients_of_colour
from physconvex.reconstruction import (
    Observation,
    ReconstructionConfig,
    RowAdam,
    even_triangles,
    footprint,
    image_loss,
    psnr,
    structural_similarity,
    welded,
)

__all__ = ["Rates", "Score", "fit_gaussians", "gaussians_on", "score_gaussians"]

WARM_UP, SHARE, DIVISIBLE, LEAST_OPACITY, OUTSIDE, SLIGHT = 20, 0.2, 2.5, 0.03, 0.2, 2.0  # as for convexes
SMALLER = 1.6


@dataclass(frozen=True)
class Rates:
    """Greatest steps: of centres in footprints, of log scales, quaternions, logits of opacities, first harmonics."""

    centre: float = 0.2
    scale: float = 0.08
    turn: float = 0.05
    opacity: float = 0.15
    colour: float = 0.05


@dataclass(frozen=True)
class Score:
    """Means over views: PSNR [dB] and SSIM of the whole image."""

    psnr: float
    ssim: float


def gaussians_on(mesh: trimesh.Trimesh, count: int, observations: Sequence[Observation]) -> Gaussians:
    """Flat Gaussians on a surface, in the mean colours of the pixels that they explain."""
    triangles = even_triangles(welded(mesh), count)
    a, b, c = np.moveaxis(triangles.corners, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    along = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1, keepdims=True), 1e-12)
    axes = np.stack([along, np.cross(normal, along), normal], axis=2)
    width = 0.6 * np.sqrt(np.maximum(triangles.areas, 1e-16))
    scales = np.stack([width, width, 0.2 * width], axis=1)
    middle = torch.as_tensor(triangles.corners.mean(axis=1), dtype=torch.float32)
    harmonics = coefficients_of_colour(torch.full((len(middle), 3), 0.5))
    scene = Gaussians(
        middle,
        torch.as_tensor(np.log(scales), dtype=torch.float32),
        quaternions_of(torch.as_tensor(axes, dtype=torch.float32)),
        torch.full((len(middle),), 0.9).logit(),
        harmonics,
    )
    sums = torch.zeros(len(scene), 4)
    for seen in observations:
        maps = torch.cat([seen.image * seen.coverage[..., None], seen.coverage[..., None]], dim=-1)
        sums += _gathered(scene, seen, maps)
    known = sums[:, 3:] > 0.05
    colours = torch.where(known, sums[:, :3] / sums[:, 3:].clamp(min=0.05), 0.5)
    return replace(scene, harmonics=coefficients_of_colour(colours))


def _gathered(scene: Gaussians, seen: Observation, maps: Tensor) -> Tensor:
    """Σ_p w_ip v_p of a four-channel image v for every Gaussian i, shape [N, 4]."""
    features = torch.zeros(len(scene), 4, requires_grad=True)
    (layers, _), _ = blend_gaussians(scene.leaves(), seen.view, replaced=features)
    (sums,) = torch.autograd.grad(layers, features, maps)
    return sums


def fit_gaussians(
    observations: Sequence[Observation],
    config: ReconstructionConfig,
    *,
    mesh: trimesh.Trimesh,
    rates: Rates | None = None,
) -> Gaussians:
    """Fit at most `config.budget` Gaussians; the settings that name points are read as centres."""
    rates = Rates() if rates is None else rates
    pixel = footprint(observations)
    scene = gaussians_on(mesh, round(config.start_share * config.budget), observations).leaves()
    adam = RowAdam.of(scene.tensors())
    levels = {scale: [seen.resized(scale).cropped() for seen in observations] for scale in set(config.levels)}
    for step in range(config.steps):
        scale = config.scale_at(step)
        if step in config.refinement_steps():
            generator = torch.Generator().manual_seed(config.seed + step)
            scene, sources, fresh = _refined(scene, levels[scale], config.budget, pixel / scale, generator)
            adam = adam.select(sources, fresh)
        epoch, place = divmod(step, len(observations))
        seen = levels[scale][np.random.default_rng([config.seed, epoch]).permutation(len(observations))[place]]
        for tensor in scene.tensors():
            tensor.grad = None
        image_loss(render_gaussians(scene, seen.view, background=seen.background), seen, config).backward()
        factor = config.final_rate ** (step / config.steps) * min(1.0, (step + 1) / WARM_UP)
        colour = torch.full((scene.harmonics.shape[1], 1), rates.colour * config.view_rate * factor)
        colour[0] = rates.colour * factor
        steps = (rates.centre * pixel, rates.scale, rates.turn, rates.opacity)
        adam.step(scene.tensors(), [*(rate * factor for rate in steps), colour])
        with torch.no_grad():
            scene.harmonics[:, 1:] *= 1 - config.view_decay
            scene.log_scales.clamp_(float(np.log(0.05 * pixel)), float(np.log(50 * pixel)))
            scene.logit_opacity.clamp_(-8.0, 8.0)
    return Gaussians(*(tensor.detach() for tensor in scene.tensors()))


def _refined(
    scene: Gaussians, views: Sequence[Observation], budget: int, pixel: float, generator: torch.Generator
) -> tuple[Gaussians, Tensor, Tensor]:
    """The Gaussians after pruning, splitting and cloning, the old one that each comes from, and which are new."""
    sums = torch.zeros(len(scene), 4)
    for seen in views:
        with torch.no_grad():
            image = render_gaussians(scene, seen.view, background=seen.background)
        error = (image.colour - seen.image).square().sum(dim=-1) + (image.alpha - seen.coverage).square()
        ones = torch.ones_like(error)
        sums += _gathered(scene, seen, torch.stack([error, ones, seen.coverage, ones], dim=-1))
    with torch.no_grad():
        charge, weight, covered = sums[:, 0], sums[:, 1], sums[:, 2]
        keep = torch.sigmoid(scene.logit_opacity) > LEAST_OPACITY
        keep &= ~((weight > 1) & (covered < OUTSIDE * weight))
        wanted = int(SHARE * len(scene))
        crowded = min(int(keep.sum()) + wanted - budget, wanted // 2)
        if crowded > 0:
            slight = (keep & (weight > 0) & (weight < SLIGHT)).nonzero()[:, 0]
            keep[slight[weight[slight].argsort()[:crowded]]] = False
        room = max(0, min(wanted, budget - int(keep.sum())))
        candidates = (keep & (charge > 0)).nonzero()[:, 0]
        chosen = candidates[charge[candidates].argsort(descending=True)[:room]]
        extent = 3 * scene.log_scales.exp().amax(dim=1)
        large = torch.zeros(len(scene), dtype=torch.bool)
        large[chosen] = extent[chosen] > DIVISIBLE * pixel
        small = torch.zeros_like(large)
        small[chosen] = ~large[chosen]
        whole, parents, clones = (some.nonzero()[:, 0] for some in (keep & ~large, large, small))
        halves = parents.repeat_interleave(2)
        sources = torch.cat([whole, halves, clones])
        shift = torch.zeros(len(sources), 3)
        spread = rotation_matrices(scene.quaternions[halves]) * scene.log_scales[halves].exp()[:, None]
        drawn = torch.randn((len(halves), 3, 1), generator=generator)
        shift[len(whole) : len(whole) + len(halves)] = (spread @ drawn)[..., 0]
        made = scene.select(sources)
        opacity = torch.sigmoid(made.logit_opacity)
        opacity = torch.where(small[sources], 1 - (1 - opacity).sqrt(), opacity)  # two let through what one did
        scales = made.log_scales - large[sources, None] * np.log(SMALLER)
        made = replace(made, centres=made.centres + shift, log_scales=scales, logit_opacity=opacity.logit())
    fresh = large[sources]
    fresh[len(sources) - len(clones) :] = True
    return made.leaves(), sources, fresh


@torch.no_grad()
def score_gaussians(scene: Gaussians, observations: Sequence[Observation]) -> Score:
    """Means over views, as `score` has them for convexes."""
    rows = []
    for seen in observations:
        colour = render_gaussians(scene, seen.view, background=seen.background).colour.clamp(0, 1)
        rows.append((psnr(colour, seen.image), float(structural_similarity(colour, seen.image))))
    return Score(*(float(mean) for mean in np.mean(rows, axis=0)))
