"""First contact of a falling body with the floor, after a rigid flight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from physconvex.dynamics import World
from physconvex.mesh import TetMesh, refine_locally

_STEP = 1e-3  # [s]
_REACH = 0.08  # of the size: wanted spacings are proportional to the height at landing plus this


def landing_heights(mesh: TetMesh, world: World, *, duration: float = 2.0) -> Float[np.ndarray, " V"] | None:
    """Height [m] of each node over the floor z = 0 when the first of them touches it; None if none does in time.

    Args:
        mesh: the body at its start.
        world: its gravity, and initial velocities.
        duration: of the flight at most [s].
    """
    gravity, velocity = np.asarray(world.gravity), np.asarray(world.initial_velocity)
    centre, inertia = mass_properties(mesh)
    arms = mesh.vertices - centre
    for time, (turn, _) in zip(
        np.arange(0.0, duration, _STEP), turning(inertia, world.initial_angular_velocity, _STEP), strict=False
    ):
        heights = turn.apply(arms)[:, 2] + centre[2] + time * velocity[2] + 0.5 * time**2 * gravity[2]
        if heights.min() <= 0.0:
            return np.maximum(heights, 0.0)
    return None


def turning(
    inertia: Float[np.ndarray, "3 3"], angular_velocity: Sequence[float] | Float[np.ndarray, " 3"], step: float
) -> Iterator[tuple[Rotation, Float[np.ndarray, " 3"]]]:
    """Rotation since the start and angular velocity [rad/s] of a free rigid body, every `step` [s] from the start on.

    Args:
        inertia: about the centre of mass at the start, in any unit.
        angular_velocity: at the start [rad/s].
        step: of the integration [s].
    """
    turn, momentum = Rotation.identity(), inertia @ np.asarray(angular_velocity)
    while True:
        axes = turn.as_matrix()
        spin = axes @ np.linalg.solve(inertia, axes.T @ momentum)
        yield turn, spin
        turn = Rotation.from_rotvec(step * spin) * turn


def mass_properties(mesh: TetMesh) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Centre [m] and inertia about it [m⁵], of density one: exact for straight tetrahedra."""
    volumes, corners = mesh.element_volumes, mesh.vertices[mesh.corner_tets]
    centre = volumes @ corners.mean(axis=1) / volumes.sum()
    arms = corners - centre
    sums = np.einsum("eia,eib->eab", arms, arms) + np.einsum("ea,eb->eab", arms.sum(axis=1), arms.sum(axis=1))
    second = np.einsum("e,eab->ab", volumes, sums) / 20.0
    return centre, np.trace(second) * np.eye(3) - second


def refine_at_landing(mesh: TetMesh, nodes: int, world: World) -> TetMesh:
    """The mesh with that many more nodes where it lands: there a few nodes carry a stiff body.

    Args:
        mesh: the body at its start.
        nodes: most added nodes.
        world: as in `landing_heights`.
    """
    heights = landing_heights(mesh, world) if nodes else None
    if heights is None:
        return mesh
    return refine_locally(mesh, heights + _REACH * mesh.size, max_nodes=len(mesh.vertices) + nodes)
