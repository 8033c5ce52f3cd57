"""Residuals of a free body in three parts: rigid motion, uniform strain, and the rest.

After an impact, two meshes of one body differ in their further flight ten times or more as much as in their strain, and
in their strain several times as much as in finer shapes. One error size for all would hide a material in the errors of
a rebound. The residuals of each frame are therefore transformed, r → Qᵀ r with Q orthogonal: the first six lie along
rigid motions of the body where it is seen, the next six along its uniform strains, the others along neither. The sum of
squares stays the same, and each kind has its own numerical error (`physconvex.gap.errors.error_model`).

Frames from the first contact on form kinds of their own. The residuals of a few hundred markers before contact do not
show how well the model follows an impact, and a mean over both would mix them.

An impact changes velocity and spin once, however many frames show the flight after it. The rigid error grows from frame
to frame without new information until the next contact. From the first contact on, these residuals therefore carry the
information of the contact frames alone, spread over all frames. A floor pushes along its normal, and sideways only by
friction. Rigid motion across the normal is a kind of its own, since models err less in it; otherwise friction, a side
wind or a tilt would hide in the errors along the normal.

Q is the product of the Householder reflections of those twelve columns, kept as I − V T Vᵀ (Golub & Van Loan, Matrix
Computations, §5.1.7).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import null_space

from physconvex.gap.thresholds import EVIDENCE, NUMERICAL_ERROR
from physconvex.identify import MarkerObservations, Observations, PixelObservations, WrappedObservations

_RIGID, _STRAIN, _REST, _PARTS = 0, 1, 2, 3
_DEPENDENT = 1e-3  # share of its length, below which a motion depends on the ones before it


@dataclass(frozen=True, eq=False)
class BodyModes:
    """An orthogonal transformation of the residuals, frame by frame.

    Attributes:
        frames: frame of each residual, shape [N].
        kinds: kind of each transformed residual: 0 rigid, 1 uniform strain, 2 the rest; 3 is added from the first
            contact on. 6 is rigid motion across the known normal of the obstacle. All are 0 without division.
        freedom: number of degrees of freedom of a smooth error in one frame, by kind.
        reflections: rows of a frame, V [n, 12] and T [12, 12], if it is transformed.
        touching: share of the frames from the first contact on in which, or next to which, the body touches something.
    """

    frames: Int[np.ndarray, " N"]
    kinds: Int[np.ndarray, " N"]
    freedom: tuple[float, ...] = (NUMERICAL_ERROR.freedom_undivided,)
    reflections: tuple[tuple[slice, Float[np.ndarray, "_ k"], Float[np.ndarray, "k k"]], ...] = ()
    touching: float = 1.0

    @property
    def count(self) -> int:
        """Number of kinds."""
        return len(self.freedom)

    @property
    def parts(self) -> Int[np.ndarray, " D"]:
        """Part of each kind: 0 rigid, 1 uniform strain, 2 the rest, whether before or after the first contact."""
        return np.arange(self.count) % _PARTS

    @property
    def struck(self) -> Bool[np.ndarray, " D"]:
        """Whether each kind belongs to frames from the first contact on."""
        return np.arange(self.count) >= _PARTS

    @property
    def across(self) -> Bool[np.ndarray, " D"]:
        """Whether each kind is rigid motion of a struck body across the normal of the obstacle."""
        return np.arange(self.count) == 2 * _PARTS

    @property
    def independent(self) -> Float[np.ndarray, " D"]:
        """Independent degrees of freedom of a smooth error per frame, by kind: half of those in two frames."""
        return np.array(self.freedom) / 4 * np.where((self.parts == _RIGID) & self.struck, self.touching, 1.0)

    def turn(self, rows: Float[np.ndarray, "*B N"]) -> Float[np.ndarray, "*B N"]:
        """Qᵀ times vectors of residuals."""
        if not self.reflections:
            return np.asarray(rows)
        out = np.array(rows)
        for where, v, t in self.reflections:
            out[..., where] -= ((out[..., where] @ v) @ t) @ v.T
        return out

    def in_frames(self, count: int) -> BodyModes:
        """The transformation of the first frames."""
        rows = int((self.frames < count).sum())
        kept = tuple(one for one in self.reflections if one[0].stop <= rows)
        return replace(self, frames=self.frames[:rows], kinds=self.kinds[:rows], reflections=kept)


def undivided(frames: Int[np.ndarray, " N"]) -> BodyModes:
    """The identity: residuals of one kind."""
    return BodyModes(frames, np.zeros(len(frames), dtype=np.int64))


def body_modes(
    seen: MarkerObservations | PixelObservations,
    *,
    free: bool,
    force: Float[np.ndarray, " T"] | None = None,
    normal: Float[np.ndarray, " 3"] | None = None,
) -> BodyModes:
    """Rigid motions and uniform strains of markers, where they are seen; `undivided` otherwise.

    Pixels are not transformed: outliers (Huber's loss) depend on each point, and depth hides half of the strains.

    Args:
        seen: the observations, frames in order.
        free: whether the body flies and strikes something. For a held body both meshes move alike.
        force: contact force in each frame [N]; none by default.
        normal: normal of the only floor; directions along and across it are not separated without it.
    """
    sides = np.eye(3) if normal is None else np.vstack([null_space(np.asarray(normal)[None]).T, normal])
    frames = np.asarray(seen.frames)
    if not free or not isinstance(seen, MarkerObservations):
        return undivided(frames)
    kinds, reflections = np.zeros(len(frames), dtype=np.int64), []
    ends = np.searchsorted(frames, np.arange(frames[-1] + 2))
    for start, stop in pairwise(ends):
        if stop - start < NUMERICAL_ERROR.fewest_divided:
            continue
        points = seen.point_indices[start:stop:3]
        where = seen.positions[frames[start], points]
        motions = _affine_motions(where, sides) / np.repeat(seen.sigma[frames[start], points], 3)[:, None]
        motions /= np.linalg.norm(motions, axis=0)
        packed, tau = np.linalg.qr(motions, mode="raw")
        v = np.tril(packed.T, -1)
        np.fill_diagonal(v, 1.0)
        reflections.append((slice(int(start), int(stop)), v, _block(v, tau)))
        found = np.repeat([_RIGID, _STRAIN], 6)
        kinds[start:stop] = _REST
        kinds[start : start + 12] = np.where(np.abs(np.diag(packed.T[:12])) > _DEPENDENT, found, _REST)
    freedom = NUMERICAL_ERROR.freedom
    if force is None or not reflections:
        return BodyModes(frames, kinds, freedom, tuple(reflections))
    struck = (np.cumsum(force > 0) > 0)[frames]
    kinds += _PARTS * struck
    if normal is not None:
        across = np.concatenate([[where.start, where.start + 1] for where, *_ in reflections])
        kinds[across[struck[across]]] = 2 * _PARTS
        along = NUMERICAL_ERROR.freedom_along
        freedom = (*freedom[:_PARTS], along, *freedom[_PARTS + 1 :], NUMERICAL_ERROR.freedom_across)
    return BodyModes(frames, kinds, freedom, tuple(reflections), _touching(force))


def _touching(force: Float[np.ndarray, " T"]) -> float:
    """Share of contact frames and their neighbours, among the frames from the first contact on."""
    touched = np.convolve(force > 0, np.ones(3), mode="same") > 0
    after = np.cumsum(force > 0) > 0
    return float(touched[after].mean()) if after.any() else 1.0


def _affine_motions(x: Float[np.ndarray, "P 3"], unit: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "n 12"]:
    """Translations along three unit vectors, rotations and uniform strains of points about their centre, as columns."""
    size = max(float(np.sqrt(((x - x.mean(0)) ** 2).sum(-1).mean())), 1e-300)
    arm = (x - x.mean(0)) / size
    columns = [np.broadcast_to(e, x.shape) for e in unit]
    columns += [np.cross(e, arm) for e in unit]
    pairs = combinations_with_replacement(unit, 2)
    columns += [arm @ (0.5 * (np.outer(a, b) + np.outer(b, a))) for a, b in pairs]
    moved = np.stack([c.ravel() for c in columns], axis=1)
    return moved + 1e-12 * np.arange(1, 13)  # a zero column (all points in one plane) keeps a direction


def _block(v: Float[np.ndarray, "n k"], tau: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
    """T of I − V T Vᵀ = (I − τ₁ v₁ v₁ᵀ) … (I − τ_k v_k v_kᵀ)."""
    t = np.zeros((len(tau), len(tau)))
    for j, factor in enumerate(tau):
        t[:j, j] = -factor * t[:j, :j] @ (v[:, :j].T @ v[:, j])
        t[j, j] = factor
    return t


@dataclass(frozen=True, eq=False)
class TurnedObservations(WrappedObservations):
    """Observations with transformed residuals, each with a widened standard deviation.

    Attributes:
        modes: transformation of all residuals.
        sigma: standard deviation of the transformed residuals in units of the stated noise, shape [N].
    """

    modes: BodyModes
    sigma: Float[np.ndarray, " N"]

    def residuals(self, positions: Float[np.ndarray, "T P 3"]) -> Float[np.ndarray, " N"]:
        """(model − seen)/σ, transformed."""
        return np.asarray(self.modes.turn(self.seen.residuals(positions)) / self.sigma)

    def linearise(
        self, positions: Float[np.ndarray, "T P 3"], tangents: Float[np.ndarray, "T K P 3"]
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N K"]]:
        """The residuals and their derivatives."""
        residuals, jacobian = self.seen.linearise(positions, tangents)
        return self.modes.turn(residuals) / self.sigma, (self.modes.turn(jacobian.T) / self.sigma).T

    def in_frames(self, count: int) -> Observations:
        """The first `count` frames alone."""
        modes = self.modes.in_frames(count)
        return TurnedObservations(self.seen.in_frames(count), modes, self.sigma[: len(modes.frames)])


def temperature(
    whitened: Float[np.ndarray, " N"], frames: Int[np.ndarray, " N"], columns: Int[np.ndarray, " N"]
) -> float:
    """Residuals per independent one; 1 for noise alone.

    The table of residuals (frames by columns) has a participation ratio of shapes and a correlation from frame to
    frame. The product of the independent shapes and moments counts for the part of the mean square above one.

    Args:
        whitened: residuals over their expected size from noise and numerical error.
        frames: frame of each.
        columns: index of each within its frame (point and coordinate).
    """
    excess = 1.0 - 1.0 / max(float(np.mean(whitened**2)), 1.0) if len(whitened) else 0.0
    seen, rows = np.unique(frames, return_inverse=True)
    if excess <= 0 or len(seen) < 2:
        return 1.0
    table = np.zeros((len(seen), int(columns.max()) + 1))
    table[rows, columns] = whitened
    strengths = np.linalg.svd(table, compute_uv=False) ** 2
    shapes = float(strengths.sum() ** 2 / (strengths**2).sum())
    lasting = float(np.clip((table[1:] * table[:-1]).sum() / (table**2).sum(), 0.0, 1.0))
    moments = len(seen) * max((1 - lasting) / (1 + lasting), EVIDENCE.smooth)
    return max(1.0, 1.0 + excess * (len(whitened) / (shapes * moments) - 1.0))
