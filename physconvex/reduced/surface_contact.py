"""Contact and friction of the surface samples in the reduced coordinates; only touching samples are evaluated."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Contact, Friction, Plane
from physconvex.reduced.compiled_body import compiled_surface


def contact_blocks(contact: Contact, x: Float[np.ndarray, "S 3"], time: float) -> Float[np.ndarray, "S 3 3"]:
    """Exact second derivatives of the contact energy [N/m], with the curvature of the obstacles."""
    blocks = contact.hessian_blocks(x, time)
    for obstacle in contact.obstacles:
        bend = obstacle.curvature(x, time)
        if not bend.any():
            continue
        bare = Contact((obstacle,), contact.areas, contact.stiffness, contact.smoothing, contact.slip_velocity)
        _, pull = bare.energy_and_gradient(x, time)  # −A ψ' n
        normals = obstacle.normals(x, time)
        tangential = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        blocks += ((pull * normals).sum(1) * bend)[:, None, None] * tangential
    return blocks


def by_height_of_planes(contact: Contact, x: Float[np.ndarray, "S 3"], time: float) -> Float[np.ndarray, "S 3"]:
    """Derivative of the gradient of the contact energy by the height of all planes [N/m]."""
    out = np.zeros_like(x)
    for plane in contact.obstacles:
        if isinstance(plane, Plane):
            nodes, depth = contact.touching(plane, x, time)
            rise = contact.areas[nodes] * contact.hinge(depth)[2]
            out[nodes] -= rise[:, None] * plane.normals(x[nodes], time)
    return out


def add_surface_blocks(
    matrix: Float[np.ndarray, "3 R 3 R"], values: Float[np.ndarray, "S R"], blocks: Float[np.ndarray, "S 3 3"]
) -> None:
    """Add Σ_s N_a(s) B_s N_b(s) over the samples whose block is not zero; the blocks are symmetric."""
    touched = np.flatnonzero(blocks.any(axis=(1, 2)))
    if not len(touched):
        return
    values, blocks = values[touched], blocks[touched]
    for i in range(3):
        for k in range(i, 3):
            part = values.T @ (blocks[:, i, k, None] * values)
            matrix[i, :, k] += part
            if i != k:
                matrix[k, :, i] += part


class SurfaceContact:
    """A contact law on the samples x_s = Σ_a N_a(s) y_a.

    Args:
        contact: the law, with the areas of the samples.
        values: N_a at the samples, shape [S, R].
    """

    def __init__(self, contact: Contact, values: Float[np.ndarray, "S R"]) -> None:
        self.contact, self.values = contact, values
        self._compiled = compiled_surface(contact, values) if contact.obstacles else None
        self._frozen: tuple[Friction, ...] = ()
        self._rows: tuple[np.ndarray, ...] = ()

    def energy_and_gradient(self, y: Float[np.ndarray, "R 3"], time: float) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Contact energy [J] and its derivative [N]."""
        if not self.contact.obstacles:
            return 0.0, np.zeros_like(y)
        if self._compiled is not None:
            return self._compiled.energy_and_gradient(y, time)
        energy, push = self.contact.energy_and_gradient(self.values @ y, time)
        return energy, self._gathered(push)

    def _gathered(self, forces: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, "R 3"]:
        """Generalised forces of forces on the samples."""
        touched = np.flatnonzero(forces.any(axis=1))
        return self.values[touched].T @ forces[touched]

    def friction(
        self, frozen: tuple[Friction, ...], velocity: Float[np.ndarray, "R 3"]
    ) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Rate potential [W] of frozen friction and its derivative by the velocities of the coordinates [N]."""
        if frozen is not self._frozen:
            self._frozen, self._rows = frozen, tuple(self.values[part.nodes] for part in frozen)
        total, gradient = 0.0, np.zeros_like(velocity)
        for part, rows in zip(frozen, self._rows, strict=True):
            relative = rows @ velocity - part.velocity
            normal = (relative * part.normals).sum(1, keepdims=True) * part.normals
            slip = normal if part.along_normal else relative - normal
            force = part.weights[:, None] * slip
            total += 0.5 * float((force * slip).sum())
            gradient += rows.T @ force
        return total, gradient
