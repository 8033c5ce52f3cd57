"""Skinning weights refined by the full model's motion at the fitted material.

The correction runs the full model in any case. Proper orthogonal decomposition of that motion gives the weights
(`physconvex.reduced.snapshot_weights`). They replace the roughest half of the twin's weights.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.fem import ElasticBody
from physconvex.identify.twin import Twin, smooth_weights
from physconvex.reduced import BodySamples, NodalWeights, ReducedSpace, WeightField, snapshot_weights


def enriched(twin: Twin, nodes: Float[np.ndarray, "T V 3"]) -> Twin:
    """The twin with the same number of weights, half of them from a motion of the full model.

    Args:
        twin: with M weights.
        nodes: positions of its mesh's nodes [m]; if their motion has a lower rank, it gives fewer weights.
    """
    weights = twin.scene.body.space.field.count
    body = ElasticBody(twin.mesh)
    for count in range((weights + 1) // 2, 0, -1):
        try:
            found = snapshot_weights(body, [nodes - twin.mesh.vertices], count)
        except InputError:  # the motion has fewer independent fields
            continue
        if count == weights:
            return with_weights(twin, found)
        kept = smooth_weights(twin.mesh, weights - count, twin.clamp)
        return with_weights(twin, NodalWeights(twin.mesh, np.hstack([kept.nodal_values, found.nodal_values])))
    return twin


def with_weights(twin: Twin, weights: WeightField) -> Twin:
    """The twin with other skinning weights, starting at rest; everything else stays."""
    old = twin.scene.body
    interpolated = twin.clamp is not None and isinstance(weights, NodalWeights)  # as `base_twin` does
    body = old.with_space(ReducedSpace(weights, BodySamples.of_mesh(twin.mesh), interpolated=interpolated))
    position = old.first_moments @ twin.scene.start / old.total_mass
    moved = twin.with_scene(body=body, initial_coordinates=None)
    rest = body.first_moments @ moved.scene.start / body.total_mass
    if np.abs(position - rest).max() < 1e-12:
        return moved
    names = tuple(f"initial_position_{axis}" for axis in "xyz")
    return moved.with_values(names, position)
