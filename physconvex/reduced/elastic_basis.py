"""Skinning weights from a body's elasticity: its vibration modes, and its responses to forces at its contacts.

Skinning eigenmodes solve a scalar problem, which ignores Poisson's ratio and the bending of thin limbs. Here the
displacements themselves are computed, by linear theory. The weights are the scalar fields whose products W_m(X) [X; 1]
approximate all of them best.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from physconvex.errors import InputError
from physconvex.fem import ElasticBody, elastic_responses, rigid_motions, skinning_stiffness, vibration_modes
from physconvex.numerics import best_rotation
from physconvex.reduced.basis import MAX_WEIGHTS, NodalWeights

_AT_ONCE = 10  # weights taken before their products are removed from the remainder
_NEGLIGIBLE = 1e-10  # share of the square norm below which a field counts as rounding
_LOOSE = 1e-3  # of the highest vibration's frequency, below which one counts as a motion of loose parts


def elastic_weights(
    body: ElasticBody,
    count: int,
    loads: Float[np.ndarray, "V K"] | None = None,
    *,
    clamped: Bool[np.ndarray, " V"] | None = None,
    vibrations: int = 30,
    states: Float[np.ndarray, "S V 3"] | None = None,
    motion: Float[np.ndarray, "T V 3"] | None = None,
) -> NodalWeights:
    """Weights whose products with [X; 1] span a body's first vibration modes and its responses to forces.

    Every vibration of a free body has the same elastic energy, as after an impact. Those of a clamped body are weighted
    as by the release of its own weight: in proportion to 1/ω², the softest with ½ J. The energy of responses is in
    proportion to the size of their loads, ½ J on average. The components of all these are scalar fields. The next
    weights are the fields that carry most of what the products of the present weights leave, in the norm of ∫ E |∇w|²:
    proper orthogonal decomposition, ten at a time. Use them with `ReducedSpace(weights, samples, interpolated=True)`.

    Args:
        body: mesh, law, E, ν and density; the responses depend little on ν.
        count: M, number of weights.
        loads: places of forces; each column acts in all three directions (`touched_loads`, `even_loads`).
        clamped: nodes that are held.
        vibrations: number of elastic vibrations, fewer on a small mesh.
        states: positions of the nodes [m] in deformed states with further responses, each rotated back. The vibrations
            about the last one, the most deformed, are added too. A squashed limb responds differently than at rest.
        motion: positions of the nodes [m] in a motion that the weights have to represent, for example one of the full
            model at about the right E; it counts as much as all vibrations and responses together.

    Raises:
        InputError: loads, nodes, states or a motion of another shape, `count` not in 1..64 or larger than all these
        permit.
    """
    if not 1 <= count <= MAX_WEIGHTS:
        raise InputError(f"count: got {count}; expected 1 to {MAX_WEIGHTS} weights")
    vertices = body.mesh.vertices
    loads = np.zeros((len(vertices), 0)) if loads is None else loads
    if np.ndim(loads) != 2 or len(loads) != len(vertices):
        raise InputError(f"loads: got shape {np.shape(loads)}; expected [{len(vertices)}, K], one row for each node")
    held = np.zeros(len(vertices), dtype=bool) if clamped is None else np.asarray(clamped)
    if held.dtype != bool or held.shape != (len(vertices),) or held.all():
        raise InputError(f"clamped: got {held.dtype} of shape {held.shape}; expected bool [{len(vertices)}], some free")
    deformed = np.zeros((0, *vertices.shape)) if states is None else np.asarray(states)
    if deformed.ndim != 3 or deformed.shape[1:] != vertices.shape or not np.isfinite(deformed).all():
        raise InputError(f"states: got shape {deformed.shape}; expected finite [S, {len(vertices)}, 3]")
    if motion is not None and (np.ndim(motion) != 3 or np.shape(motion)[1:] != vertices.shape):
        raise InputError(f"motion: got shape {np.shape(motion)}; expected [T, {len(vertices)}, 3]")
    if not held.any():
        deformed = np.array([x @ best_rotation(vertices, x, body.node_masses) for x in deformed])
    moved = [_vibrations(body, vibrations, held, state) for state in (None, *deformed[-1:])]
    if np.size(loads):
        forces = np.einsum("vk,cd->kcvd", loads, np.eye(3)).reshape(-1, len(vertices), 3)
        sizes = np.repeat(np.abs(loads).sum(0), 3)
        shares = np.sqrt(sizes / sizes.mean())[:, None, None]
        moved += [shares * elastic_responses(body, forces, state, clamped=held) for state in (None, *deformed)]
    fields = np.moveaxis(np.concatenate(moved), 1, 0).reshape(len(vertices), -1)
    followed = None if motion is None else np.moveaxis(np.asarray(motion), 1, 0).reshape(len(vertices), -1)
    weights = _covering_weights(fields, vertices, body, count, followed)
    square = np.einsum("vk,vk->k", weights, body.mass @ weights)
    return NodalWeights(body.mesh, weights * np.sqrt(body.total_mass / square))


def _vibrations(
    body: ElasticBody, count: int, clamped: np.ndarray, state: np.ndarray | None
) -> Float[np.ndarray, "K V 3"]:
    """Elastic vibrations about a state, each with elastic energy ½ J; of a clamped body in proportion to 1/ω²."""
    rigid = len(rigid_motions(body.mesh.vertices, clamped))
    number = min(count, 3 * int((~clamped).sum()) - 2 - rigid)
    frequencies, shapes = vibration_modes(body, number + rigid, clamped=clamped, positions=state)
    frequencies = np.maximum(frequencies[rigid:], _LOOSE * frequencies[-1])  # loose parts move without any energy
    amplitudes = 1 / (2 * np.pi * frequencies)
    if clamped.any():
        amplitudes *= frequencies[0] / frequencies
    return shapes[rigid:] * amplitudes[:, None, None]


def _covering_weights(
    fields: np.ndarray, vertices: np.ndarray, body: ElasticBody, count: int, motion: np.ndarray | None
) -> np.ndarray:
    """Weights at the nodes whose products with [X; 1] approximate scalar fields best, best first, [V, M]."""
    stiffness, mass = skinning_stiffness(body), body.mass
    norm = stiffness + 1e-3 * stiffness.diagonal().sum() / mass.diagonal().sum() * mass  # the constant is a field too
    homogeneous = np.column_stack([(vertices - vertices.mean(0)) / body.mesh.size, np.ones(len(vertices))])
    given = principal_fields(homogeneous, norm)
    if motion is not None:
        squares = [
            float(np.einsum("vk,vk->", one, norm @ one))
            for one in (f - given @ (given.T @ (norm @ f)) for f in (fields, motion))
        ]
        fields = np.hstack([fields, motion * np.sqrt(squares[0] / squares[1])]) if squares[1] > 0 else fields
    weighted = norm @ fields
    largest, weights = float(np.einsum("vk,vk->k", fields, weighted).max()), np.zeros((len(vertices), 0))
    while weights.shape[1] < count:
        left = fields - given @ (given.T @ weighted)
        found = principal_fields(left, norm, largest=largest)[:, : min(_AT_ONCE, count - weights.shape[1])]
        if not found.shape[1]:
            raise InputError(
                f"count: got {count}; vibrations and answers are spanned by {weights.shape[1]} weights already; give "
                "fewer weights, or more loads or vibrations"
            )
        weights = np.hstack([weights, found])
        products = (found[:, :, None] * homogeneous[:, None, :]).reshape(len(vertices), -1)
        for _ in range(2):  # the second pass removes rounding errors
            products = products - given @ (given.T @ (norm @ products))
        given = np.hstack([given, principal_fields(products, norm)])
    return weights


def principal_fields(
    fields: Float[np.ndarray, "V K"], norm: sp.csr_matrix, *, largest: float | None = None
) -> Float[np.ndarray, "V R"]:
    """Span of fields, orthonormal in a norm, in decreasing order of their content (Sirovich 1987).

    Args:
        fields: as columns.
        norm: symmetric and positive, shape [V, V].
        largest: square norm relative to which rounding is judged; that of the first result unless given.

    Returns:
        as many columns as the fields have independent directions.
    """
    squares, mixing = np.linalg.eigh(fields.T @ (norm @ fields))
    squares, mixing = squares[::-1], mixing[:, ::-1]
    kept = squares > _NEGLIGIBLE * (squares.max(initial=0.0) if largest is None else largest)
    return np.asarray(fields @ (mixing[:, kept] / np.sqrt(squares[kept])))
