"""The convex twin: a body sampled within the hulls of its convex field, moved by skinning weights, without a mesh.

The samples of the solid (`physconvex.convex.union_samples`) carry mass and energy; the surface carries the contact. The
weights W^θ may come from vibration modes, contact responses and a motion of the full model, from eigenmodes, from the
data-free training of the paper's eq. 4, or from a network's prediction. A mesh of few nodes serves only to find them.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import torch
import trimesh

from physconvex.convex import ConvexField, union_samples
from physconvex.errors import InputError
from physconvex.identify.model import FullModel
from physconvex.identify.twin import Twin, smooth_weights, with_body
from physconvex.reduced import (
    NodalWeights,
    ReducedBody,
    ReducedSpace,
    WeightField,
    parameter_values,
    train_neural_weights,
    weights_for_motion,
)

Basis = Literal["elastic", "eigenmodes", "neural"]
_SOLID = 6  # points of a convex with which the inside of a body can be filled


def convex_twin(
    twin: Twin,
    field: ConvexField,
    basis: Basis | WeightField = "elastic",
    *,
    weights: int = 20,
    moving: Twin | None = None,
) -> Twin:
    """The twin with its body replaced by the solid of a convex field; everything else stays.

    Args:
        twin: the base twin; its surface must be closed.
        field: convexes of the body at rest [m], whose gaps are filled; fields of fewer than six points per convex give
            the surface's inside.
        basis: the skinning weights: `elastic` (vibration modes, responses to contacts, and the motion of the full model
            on the twin's mesh, see `physconvex.reduced.weights_for_motion`), `eigenmodes`, `neural` (trained on the
            body alone), or given.
        weights: number M of the weights, if they are not given.
        moving: the twin whose motion shows the contacts; this one unless given.

    Raises:
        InputError: an open surface, hulls that fill nothing of it, an unknown basis.
        ConvergenceError: the motion that shows the contacts cannot be computed.
    """
    surface = trimesh.Trimesh(*twin.surface, process=False)
    if not surface.is_watertight:
        raise InputError("convex twin: the body's surface is open; expected a closed one, such as body.ply")
    samples = union_samples(field if field.points.shape[1] >= _SOLID else None, surface)
    found: WeightField
    if not isinstance(basis, str):
        found = basis
    elif basis == "neural":
        generator, ratio = torch.Generator().manual_seed(0), float(np.mean(twin.scene.body.poisson_ratio))
        found = train_neural_weights(samples, weights, generator=generator, poisson_ratio=ratio)
    else:
        found = skinning_weights(moving or twin, basis, weights)
    space = ReducedSpace(found, samples, interpolated=isinstance(found, NodalWeights))
    body = twin.scene.body
    modulus, ratio, density = (float(v[0]) for v in (body.youngs_modulus, body.poisson_ratio, body.density))
    solid = ReducedBody(
        space, law=body.law, flow=body.flow, youngs_modulus=modulus, poisson_ratio=ratio, density=density
    )
    return with_body(twin, solid)


def skinning_weights(twin: Twin, basis: Literal["elastic", "eigenmodes"], count: int) -> NodalWeights:
    """Skinning weights on a twin's mesh, see `convex_twin`.

    Raises:
        InputError: an unknown basis.
        ConvergenceError: the motion that shows the contacts cannot be computed.
    """
    if basis not in ("elastic", "eigenmodes"):
        raise InputError(f"basis: got {basis!r}; expected one of {', '.join(get_args(Basis))}")
    if basis == "eigenmodes":
        return smooth_weights(twin.mesh, count, twin.clamp)
    body, names = twin.full_scene().body, ("log10_youngs_modulus",)
    model = FullModel(twin, names, twin.mesh.vertices, twin.capture.observed_frames)
    positions = model.node_positions(parameter_values(twin.scene, names))
    times, held = np.arange(len(positions)) / twin.fps, None if twin.clamp is None else twin.clamp.held
    return weights_for_motion(body, count, positions, times, twin.scene.obstacles, clamped=held, spanned=True)
