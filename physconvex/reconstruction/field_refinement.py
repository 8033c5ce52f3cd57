"""Adaptive refinement: adds convexes where images differ, and removes those that explain nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from physconvex.convex import ConvexField, halve
from physconvex.errors import InputError
from physconvex.reconstruction.observation import Observation, gather
from physconvex.render import render

LEAST_OPACITY = 0.03
OPAQUE = 0.5  # a convex with at least this opacity that hardly explains a pixel is hidden
DIVISIBLE = 2.5  # extent in footprints from which a convex is split; smaller ones are cloned
SHARE = 0.2  # of the convexes that one refinement may divide
CLONE_SHIFT = 0.25  # of its extent by which a clone is moved
SLIGHT = 2.0  # pixels, over all views, below which a convex may be removed for others
OUTSIDE = 0.2  # a convex is a floater if less than this share of its pixels is covered by the object


@dataclass(frozen=True, eq=False)
class RefinedField:
    """A new field.

    Attributes:
        field: the convexes.
        sources: the old convex that contains each, shape [M].
        fresh: which are new, shape [M].
        fixed: convexes that do not change until the next refinement: fillers, and those that no view shows, shape [M].
        pruned, split, cloned: their numbers.
    """

    field: ConvexField
    sources: Int[Tensor, " M"]
    fresh: Bool[Tensor, " M"]
    fixed: Bool[Tensor, " M"]
    pruned: int
    split: int
    cloned: int


@torch.no_grad()
def refine_field(
    field: ConvexField,
    observations: Sequence[Observation],
    *,
    budget: int,
    footprint: float,
    fixed: Bool[Tensor, " N"],
    generator: torch.Generator,
    keep_hidden: bool = True,
) -> RefinedField:
    """Prune, split and clone.

    The cost of a convex is the sum of squared differences of the pixels it explains (by `gather`, over all views).
    Transparent convexes and those that explain background are pruned. If the budget is full, small and hardly visible
    ones are pruned too, so that the most expensive ones can be divided. Opaque convexes that no view shows (`hidden`)
    do not change, since no pixel constrains them, unless `keep_hidden` is false.

    Args:
        budget: most convexes afterwards.
        footprint: size of a pixel at the object [m].
        fixed: those of the last refinement, at first the fillers and the `hidden` ones, shape [N].
        generator: of the directions in which clones are moved.
        keep_hidden: whether invisible convexes are part of the body, since the surface is known at the start; those of
            a visual hull or of points may be outside.
    """
    charge, weight, covered = _charged(field, observations)
    floating = (weight > 1) & (covered < OUTSIDE * weight)
    extent = _extent(field)
    were_fixed, fillers = fixed, fixed & (field.opacity < LEAST_OPACITY)
    fixed = fillers
    if keep_hidden:
        fixed = fixed | _hidden(field, weight, were_fixed | (extent > DIVISIBLE * footprint))
    keep = fixed | ((field.opacity > LEAST_OPACITY) & ~floating)
    wanted = int(SHARE * len(field))
    crowded = min(int(keep.sum()) + wanted - budget, wanted // 2)
    if crowded > 0:
        slight = (keep & ~fixed & (weight > 0) & (weight < SLIGHT)).nonzero()[:, 0]
        keep[slight[weight[slight].argsort()[:crowded]]] = False
    room = max(0, min(wanted, budget - int(keep.sum())))
    candidates = (keep & ~fixed & (charge > 0)).nonzero()[:, 0]
    chosen = candidates[charge[candidates].argsort(descending=True)[:room]]
    large = torch.zeros_like(keep)
    large[chosen] = extent[chosen] > DIVISIBLE * footprint
    small = torch.zeros_like(large)
    small[chosen] = ~large[chosen]
    return _divided(field, generator, keep=keep, large=large, small=small, fixed=fixed)


def _divided(
    field: ConvexField, generator: torch.Generator, *, keep: Tensor, large: Tensor, small: Tensor, fixed: Tensor
) -> RefinedField:
    """The convexes that are kept, those split (`large`) and those cloned (`small`), each mask of shape [N]."""
    extent = _extent(field)
    overlap = 2.0 / (field.smoothness * field.sharpness)
    whole, parents = (keep & ~large).nonzero()[:, 0], large.nonzero()[:, 0]
    parts = halve(field.points[parents], torch.minimum(overlap, 0.2 * extent)[parents])
    sources = torch.cat([whole, parents.repeat_interleave(2)])
    divided = field.select(sources).with_points(torch.cat([field.points[whole], parts.flatten(0, 1)]))
    fresh = large[sources]
    clones = small.nonzero()[:, 0]
    shift = torch.randn((len(clones), 3), generator=generator, device=generator.device).to(field.points)
    shift = CLONE_SHIFT * extent[clones, None] * shift / shift.norm(dim=1, keepdim=True)
    copies = field.select(clones)
    copies = copies.with_points(copies.points + shift[:, None])
    joined = ConvexField.joined([divided, copies])
    sources = torch.cat([sources, clones])
    fresh = torch.cat([fresh, torch.ones_like(clones, dtype=torch.bool)])
    # a convex and its clone together transmit as much as the convex alone: (1 − o')² = 1 − o
    doubled = small[sources]
    opacity = torch.where(doubled, 1 - (1 - joined.opacity).clamp(min=0).sqrt(), joined.opacity)
    new = replace(joined, opacity=opacity)
    return RefinedField(new, sources, fresh, fixed[sources], int((~keep).sum()), len(parents), len(clones))


@torch.no_grad()
def hidden(field: ConvexField, observations: Sequence[Observation], *, footprint: float) -> Bool[Tensor, " N"]:
    """Convexes that are opaque and large enough to be visible, but explain less than two pixels of all views.

    Args:
        footprint: size of a pixel at the object [m].
    """
    return _hidden(field, _charged(field, observations)[1], _extent(field) > DIVISIBLE * footprint)


def _hidden(field: ConvexField, weight: Tensor, candidates: Tensor) -> Bool[Tensor, " N"]:
    return candidates & (field.opacity > OPAQUE) & (weight < SLIGHT)


def _extent(field: ConvexField) -> Float[Tensor, " N"]:
    """Twice the greatest distance of a point from the centre [m]."""
    return 2 * torch.linalg.vector_norm(field.points - field.centres[:, None], dim=2).amax(dim=1)


@torch.no_grad()
def simplify(field: ConvexField, observations: Sequence[Observation], *, budget: int) -> ConvexField:
    """At most `budget` of the convexes: those that explain most pixels of the views, in their order.

    Invisible ones are removed first, so that images change least and the inside of the body becomes empty.

    Raises:
        InputError: a budget below one.
    """
    if budget < 1:
        raise InputError(f"budget: got {budget}; expected at least one convex")
    weight = _charged(field, observations)[1]
    return field.select(weight.argsort(descending=True, stable=True)[:budget].sort().values)


def _charged(
    field: ConvexField, observations: Sequence[Observation]
) -> tuple[Float[Tensor, " N"], Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Squared differences, pixels, and covered pixels of each convex over all views."""
    sums = field.points.new_zeros((len(field), 3))
    for seen in observations:
        image = render(field, seen.view, background=seen.background)
        error = (image.colour - seen.image).square().sum(dim=-1) + (image.alpha - seen.coverage).square()
        maps = torch.stack([error, torch.ones_like(error), seen.coverage], dim=-1)
        with torch.enable_grad():
            sums += gather(field, seen.view, maps).values
    return sums[:, 0], sums[:, 1], sums[:, 2]
