"""Eigenmodes: vibration modes of a body, and the scalar modes that serve as skinning weights."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Bool, Float
from scipy.sparse.linalg import LinearOperator, eigsh

from physconvex.errors import InputError
from physconvex.fem.assembly import Assembler, scalar_matrix
from physconvex.fem.body import ElasticBody
from physconvex.numerics import SymmetricSolver


def _smallest(stiffness: sp.csr_matrix, mass: sp.csr_matrix, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The `count` smallest eigenpairs, by shift-invert below zero; a fixed start makes them repeatable."""
    if not 0 < count < stiffness.shape[0] - 1:
        raise InputError(f"count: got {count}; expected between 1 and {stiffness.shape[0] - 2} for this mesh")
    scale = stiffness.diagonal().sum() / mass.diagonal().sum()
    start = np.random.default_rng(0).normal(size=stiffness.shape[0])
    shift = 1e-6 * scale
    with _factorised(stiffness + shift * mass) as solver:
        inverse = LinearOperator(stiffness.shape, matvec=solver.solve, dtype=np.float64)
        values, vectors = eigsh(stiffness, k=count, M=mass, sigma=-shift, v0=start, OPinv=inverse)
    order = np.argsort(values)
    return values[order], vectors[:, order]


@contextmanager
def _factorised(matrix: sp.csr_matrix) -> Iterator[SymmetricSolver]:
    upper = sp.triu(matrix, format="csr")
    upper.sort_indices()
    solver = SymmetricSolver(upper)
    try:
        solver.factorise(upper.data)
        yield solver
    finally:
        solver.close()


def tangent_stiffness(
    body: ElasticBody,
    positions: Float[np.ndarray, "V 3"] | None = None,
    *,
    free: Bool[np.ndarray, " V"] | None = None,
    project: bool = False,
) -> sp.csr_matrix:
    """Second derivative of the energy by the free nodes' coordinates, x, y, z by turns [N/m], shape [3 V', 3 V'].

    Args:
        body: the body.
        positions: of its nodes [m]; at rest unless given.
        free: nodes that may move, all unless given.
        project: remove the negative part of each point's Hessian.
    """
    assembler = Assembler(body.mesh.tets, np.ones(len(body.mesh.vertices), dtype=bool) if free is None else free)
    upper = assembler.pattern.copy()
    x = body.mesh.vertices if positions is None else positions
    upper.data = assembler.elements(body.element_hessians(x, project=project))
    return (upper + sp.triu(upper, 1).T).tocsr()


def _relieved(
    stiffness: sp.csr_matrix, mass: sp.csr_matrix, rigid: np.ndarray, loads: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Static responses to loads, with inertia relief, and the loads balanced by inertia (Craig & Kurdila 2006, §17.3).

    Args:
        stiffness, mass: of a free body, shape [N, N].
        rigid: motions that the stiffness does not resist, orthonormal in the mass, shape [R, N].
        loads: shape [N, K].

    Returns:
        responses and balanced loads without a rigid part, shape [N, K].
    """
    balanced = loads - mass @ (rigid.T @ (rigid @ loads))
    shift = 1e-8 * stiffness.diagonal().sum() / mass.diagonal().sum()  # removes the rigid motions
    with _factorised(stiffness + shift * mass) as solver:
        answers = solver.solve(balanced)
    return answers - rigid.T @ (rigid @ (mass @ answers)), balanced


def rigid_motions(
    positions: Float[np.ndarray, "V 3"], clamped: Bool[np.ndarray, " V"] | None = None
) -> Float[np.ndarray, "R V 3"]:
    """Rigid displacements and rotations that leave the held nodes at rest; six for a free body."""
    turns = np.cross(np.eye(3)[:, None], (positions - positions.mean(0)) / np.abs(np.ptp(positions, axis=0)).max())
    motions = np.concatenate([np.broadcast_to(np.eye(3)[:, None], turns.shape), turns])
    if clamped is None or not clamped.any():
        return motions
    _, sizes, mixing = np.linalg.svd(motions[:, clamped].reshape(6, -1).T, full_matrices=True)
    held = int((sizes > 1e-6 * sizes[0]).sum())
    return np.tensordot(mixing[held:], motions, 1)


def elastic_responses(
    body: ElasticBody,
    forces: Float[np.ndarray, "K V 3"],
    positions: Float[np.ndarray, "V 3"] | None = None,
    *,
    clamped: Bool[np.ndarray, " V"] | None = None,
) -> Float[np.ndarray, "K V 3"]:
    """Static displacements of a body under forces at its nodes, each with elastic energy ½ J.

    Held nodes carry the forces. Inertia balances the rigid part of the forces, and the displacement has no rigid part:
    the attachment modes with inertia relief of component mode synthesis (Craig & Kurdila 2006, §17.3).

    Args:
        body: mesh, law, stiffness and density.
        forces: any unit, since the displacements are scaled.
        positions: of the nodes in the state of linearisation [m], at rest unless given. The stiffness of a deformed
            state is made positive definite; since its stresses resist rotations, ½ J holds only approximately.
        clamped: nodes that are held.

    Raises:
        InputError: forces or positions of another shape, or a force that causes no deformation.
    """
    vertices = body.mesh.vertices
    if np.ndim(forces) != 3 or np.shape(forces)[1:] != vertices.shape or not np.isfinite(forces).all():
        raise InputError(f"forces: got shape {np.shape(forces)}; expected finite [K, {len(vertices)}, 3]")
    state = vertices if positions is None else positions
    if np.shape(state) != vertices.shape or not np.isfinite(state).all():
        raise InputError(f"positions: got shape {np.shape(state)}; expected finite [{len(vertices)}, 3]")
    free = _free(body, clamped)
    rigid = rigid_motions(state, ~free)[:, free].reshape(-1, 3 * free.sum())
    mass = sp.kron(body.mass[free][:, free], sp.eye(3)).tocsr()
    rigid = np.linalg.solve(np.linalg.cholesky(rigid @ (mass @ rigid.T)), rigid)
    loads = np.asarray(forces)[:, free].reshape(len(forces), -1).T
    stiffness = tangent_stiffness(body, state, free=free, project=positions is not None)
    answers, balanced = _relieved(stiffness, mass, rigid, loads)
    if (np.abs(balanced).max(0) <= 1e-9 * np.abs(forces).max((1, 2))).any():
        raise InputError("forces: one of them only moves the body as a whole, or acts where it is held; leave it out")
    energies = np.einsum("vk,vk->k", answers, balanced)  # positive also if loose parts move without elastic energy
    responses = np.zeros(np.shape(forces))
    responses[:, free] = (answers / np.sqrt(energies)).T.reshape(len(forces), -1, 3)
    return responses


def _free(body: ElasticBody, clamped: np.ndarray | None) -> Bool[np.ndarray, " V"]:
    return np.ones(len(body.mesh.vertices), dtype=bool) if clamped is None else ~np.asarray(clamped, dtype=bool)


def vibration_modes(
    body: ElasticBody,
    count: int,
    *,
    clamped: Bool[np.ndarray, " V"] | None = None,
    carried: Float[np.ndarray, " V"] | None = None,
    positions: Float[np.ndarray, "V 3"] | None = None,
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "K V 3"]]:
    """Frequencies [Hz] and mass-normalised shapes of the smallest vibrations about the rest state, or another one.

    A free body has six rigid modes of frequency zero at rest, which are among them.

    Args:
        body: the body.
        count: number of vibrations K.
        clamped: nodes that are held.
        carried: masses that move with the nodes, besides the body's own [kg].
        positions: of the nodes in the state about which the body vibrates [m], at rest unless given; the stiffness of
            a deformed one is made positive.
    """
    free = _free(body, clamped)
    stiffness = tangent_stiffness(body, positions, free=free, project=positions is not None)
    own = body.mass if carried is None else body.mass + sp.diags(carried)
    mass = sp.kron(own[free][:, free], sp.eye(3)).tocsr()
    values, vectors = _smallest(stiffness, mass, count)
    shapes = np.zeros((count, len(free), 3))
    shapes[:, free] = vectors.T.reshape(count, -1, 3)
    return np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi), shapes


def _direction_tensor(body: ElasticBody) -> Float[np.ndarray, "E q 3 3"]:
    """A_jl = ¼ Σ_c ∂²Ψ/∂F_cj ∂F_cl at rest for μ = 1, λ = 0: the unit tensor, and more along fibres."""
    gradients = body._gradients
    rest = torch.eye(3).to(gradients).expand(*gradients.shape[:2], 3, 3)
    one = torch.ones_like(rest[..., 0, 0])
    hessian = body.law.hessian(rest, one, 0 * one).unflatten(-1, (3, 3)).unflatten(-3, (3, 3))
    tensor: Float[np.ndarray, "E q 3 3"] = torch.einsum("eqcjcl->eqjl", hessian).cpu().numpy() / 4
    return tensor


def skinning_stiffness(body: ElasticBody) -> sp.csr_matrix:
    """Matrix of ∫ E ∇w · A ∇w at the nodes [N/m], the energy of `skinning_eigenmodes`, shape [V, V]."""
    gradients = body._gradients.cpu().numpy()
    weights = body._weights.cpu().numpy() * body.modulus_at_points
    local = np.einsum("eq,eqai,eqij,eqbj->eab", weights, gradients, _direction_tensor(body), gradients, optimize=True)
    return scalar_matrix(body.mesh.tets, local, len(body.mesh.vertices))


def skinning_eigenmodes(body: ElasticBody, count: int) -> tuple[Float[np.ndarray, "V K"], Float[np.ndarray, " K"]]:
    """Scalar modes of the stiffness-weighted Laplacian, the constant mode left out.

    Minimises ∫ E ∇w · A ∇w for given ∫ ρ w², free boundary: the skinning weights of Benchekroun et al. 2023 ("Fast
    Complementary Dynamics via Skinning Eigenmodes"), with the elastic Hessian replaced by its mean over the directions
    of displacement. A is the unit tensor of an isotropic law, I + ¼ (k/μ) a aᵀ with fibres along a. A stiff inclusion
    moves as one, and so do points joined by fibres.

    Returns:
        weights [V, K] at the nodes, normalised to ∫ ρ w² = total mass, and the eigenvalues [1/s²].
    """
    values, vectors = _smallest(skinning_stiffness(body), body.mass, count + 1)
    vectors = vectors[:, 1:] * np.sqrt(body.total_mass)
    signs = np.sign(vectors[np.abs(vectors).argmax(0), np.arange(count)])
    return vectors * signs, values[1:]
