"""Skinning weights that give way where something touches: answers to loads on patches of the surface.

The first eigenmodes are smooth all over the body; under a corner that lands on a floor they are far too stiff. Patches
spread evenly over the whole surface, each with the static answer to a load on it, make a body as soft to the touch
anywhere as the patches are fine.
"""

from __future__ import annotations

import numpy as np

from physconvex.errors import InputError
from physconvex.fem.body import ElasticBody
from physconvex.fem.modes import skinning_eigenmodes, skinning_responses
from physconvex.reduced.basis import MAX_WEIGHTS, NodalWeights
from physconvex.reduced.loads import even_loads

__all__ = ["contact_weights"]


def contact_weights(body: ElasticBody, patches: int, *, eigenmodes: int = 0) -> NodalWeights:
    """Weights of a body on its own mesh: eigenmodes, and answers to even loads on patches of its surface.

    Args:
        body: mesh, stiffness and density; quadratic meshes give much smoother weights than linear ones.
        patches: number of patches.
        eigenmodes: number of eigenmodes before them, see `eigenmode_weights`.

    Raises:
        InputError: no patch, more weights than 64 together, or more patches than surface nodes.
    """
    boundary = np.flatnonzero(body.mesh.node_areas > 0)
    if eigenmodes < 0 or not 1 <= patches <= min(MAX_WEIGHTS - eigenmodes, len(boundary)):
        raise InputError(
            f"patches, eigenmodes: got {patches} and {eigenmodes}; expected at least one patch, at most "
            f"{MAX_WEIGHTS} weights together, and at most {len(boundary)} patches, the number of nodes on the surface"
        )
    answers = skinning_responses(body, even_loads(body.mesh, patches))
    if not eigenmodes:
        return NodalWeights(body.mesh, answers)
    return NodalWeights(body.mesh, np.hstack([skinning_eigenmodes(body, eigenmodes)[0], answers]))
