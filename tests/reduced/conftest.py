"""Small reduced bodies shared by the tests.

The imports are inside the fixtures: `--typecheck` wants to be there before the packages are imported.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from physconvex.reduced import ReducedBody, ReducedSpace

SIZE = (0.3, 0.2, 0.1)


@pytest.fixture(scope="session")
def space_of() -> Callable[..., ReducedSpace]:
    """Box spaces by (order of the mesh, number of weights), each made once."""
    from physconvex.fem import ElasticBody
    from physconvex.mesh import box_mesh
    from physconvex.reduced import BodySamples, ReducedSpace, eigenmode_weights

    made: dict[tuple[int, int], ReducedSpace] = {}

    def get(order: int = 2, count: int = 3) -> ReducedSpace:
        if (order, count) not in made:
            mesh = box_mesh(SIZE, (2, 1, 1), order=order)
            field = eigenmode_weights(ElasticBody(mesh), count)
            made[order, count] = ReducedSpace(field, BodySamples.of_mesh(mesh))
        return made[order, count]

    return get


@pytest.fixture(scope="session")
def mixed_body(space_of: Callable[..., ReducedSpace]) -> Callable[..., ReducedBody]:
    """Heterogeneous bodies of 10 kPa on those spaces."""
    from physconvex.reduced import ReducedBody

    def get(order: int = 2, law: str = "neo_hookean", **constants) -> ReducedBody:
        space, rng = space_of(order), np.random.default_rng(5)
        count = space.samples.interior.cell_count
        heterogeneous = {
            "youngs_modulus": 1e4 * rng.uniform(0.5, 3.0, count),
            "poisson_ratio": rng.uniform(0.2, 0.49, count),
            "density": rng.uniform(500, 2000, count),
        }
        return ReducedBody(space, law=law, **(heterogeneous | constants))

    return get
