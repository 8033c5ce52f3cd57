"""Eliminates rigid drift: the flight of a body after an impact depends on details that no model has.

A mesh error of a hundredth of the size at the point of contact turns the rebound by degrees. A fit without rigid
freedom then distorts the material until the rebound fits. So from the first contact on, the recording may differ from
the model by a growing rigid motion. Every later frame k adds a change of velocity δv_k and of spin δω_k,

    x_t → x_t + Σ_{k ≤ t} (t − k + ½) Δt [δv_k + δω_k × (x_t − c_t)],     δv_k, r δω_k ~ N(0, q²) in each axis,

where c_t is the points' centre and r their radius of gyration. This is an integrated random walk, like the process
noise of a Kalman smoother. The kicks are fitted by a few Gauss–Newton steps, since drift may exceed the linear range of
images. The residuals are whitened by (I + N Nᵀ)^(−½) about the fitted drift, where N are their derivatives by the kicks
in units of q: estimates and intervals include the drift.

q maximises the marginal likelihood, with ½ log det(I + N Nᵀ) as its penalty. It is zero if the model fits. It is at
most a few times the difference of two meshes of the body (`model_drift`): otherwise drift could hide a wrong material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from physconvex.dynamics import Plane, Sphere
from physconvex.identify.nuisance import Elimination, MarginalObservations
from physconvex.identify.observations import (
    Jacobian,
    Observations,
    Residuals,
    StackedObservations,
    WrappedObservations,
)
from physconvex.identify.outlines import with_drawn_outlines
from physconvex.identify.photometric import PhotometricObservations
from physconvex.identify.point_models import Positions, Tangents
from physconvex.io import Workers
from physconvex.numerics import best_rotation, huber_loss, huber_weights

_TURNS, _SETTLED = 6, 1e-3  # Gauss–Newton steps of the kicks; the last one's size in standard deviations
_SLOW = 0.5  # a step that is longer than so much of the last one: derivatives are computed again
_DRAWN = 2  # first steps, in which the model's outline is found again
_SHARES = (0.03, 0.1, 0.3, 1.0)  # values of q that are tried, as shares of the largest
_TOUCH = 2e-3  # of the body's size


def first_contact(
    positions: Positions,
    obstacles: Sequence[Plane | Sphere],
    times: Float[np.ndarray, " T"],
    gravity: Sequence[float] | Float[np.ndarray, " 3"],
) -> int | None:
    """The first frame by which one of the points has touched an obstacle, at least 1; None if there is no contact.

    A contact between two frames is detected from the end of the free flight that the preceding frames predict.

    Args:
        positions: of points of the surface [m].
        obstacles: planes and spheres.
        times: of the frames, equally spaced [s].
        gravity: [m/s²].
    """
    reach = _TOUCH * float(np.ptp(positions[0], axis=0).max())
    fall = np.asarray(gravity) * (times[1] - times[0]) ** 2 if len(times) > 1 else np.zeros(3)
    for frame, (points, time) in enumerate(zip(positions, times, strict=True)):
        free = 2 * positions[frame - 1] - positions[frame - 2] + fall if frame > 1 else points
        if any((obstacle.gap(x, float(time)) < reach).any() for obstacle in obstacles for x in (points, free)):
            return max(frame, 1)
    return None


@dataclass(frozen=True, eq=False)
class RigidDriftObservations(WrappedObservations):
    """Observations with rigid drift since the first contact eliminated.

    Attributes:
        seen: the observations.
        begin: frame of the first contact, at least 1.
        interval: time between frames Δt [s].
        sigma: standard deviation q of each frame's change of velocity, and of spin times r [m/s].
        begun: kicks [C] in units of q with which their fit begins, see `begun_at`; zero unless given.
    """

    seen: Observations
    begin: int
    interval: float
    sigma: float
    begun: Float[np.ndarray, " C"] | None = None
    _last: list[np.ndarray] = field(default_factory=list, init=False, repr=False)

    def in_frames(self, count: int) -> RigidDriftObservations:
        """The first `count` frames alone."""
        return replace(self, seen=self.seen.in_frames(count), begun=None)

    def begun_at(self, positions: Positions) -> RigidDriftObservations:
        """The same, with a start of the kicks that is near for motions near these positions [m]."""
        return replace(self, begun=self._fitted(positions, self._kicks(positions)))

    def residuals(self, positions: Positions) -> Residuals:
        """Whitened residuals."""
        return self.linearise(positions, np.zeros((len(positions), 0, *positions.shape[1:])))[0]

    def linearise(self, positions: Positions, tangents: Tangents) -> tuple[Residuals, Jacobian]:
        """Whitened residuals and their derivatives (those of the kicks held fixed)."""
        kicks = self._kicks(positions)
        fitted = self._fitted(positions, kicks)
        residuals, jacobian, slopes = self._by_kicks(self.seen, kicks.moved(positions, fitted), kicks, tangents)
        columns = np.hstack([(residuals - slopes.along(fitted[:, None])[:, 0])[:, None], jacobian])
        inner = Elimination.of(slopes.gram()).inner
        columns = columns + slopes.along(inner @ slopes.across(columns))
        return columns[:, 0], columns[:, 1:]

    def drift(self, positions: Positions) -> Float[np.ndarray, "T P 3"]:
        """Rigid drift of the recording from the model [m]."""
        kicks = self._kicks(positions)
        return kicks.moved(positions, self._fitted(positions, kicks)) - positions

    def carried(
        self, positions: Float[np.ndarray, "F P 3"], others: Float[np.ndarray, "F V 3"]
    ) -> Float[np.ndarray, "F V 3"]:
        """Positions of other points of the body, drift included [m].

        Beyond the observed frames the drift continues at the last velocity and spin.

        Args:
            positions: the model's positions of the observed points, in at least all observed frames [m].
            others: the model's positions of the other points, in the same frames [m].
        """
        count = int(self.frames.max()) + 1
        seen = positions[:count]
        fitted = self._fitted(seen, self._kicks(seen))
        return self._kicks(positions, others, kicked=count).moved(others, fitted)

    def drift_velocity(self, positions: Positions, others: Float[np.ndarray, "T V 3"]) -> Float[np.ndarray, "V 3"]:
        """Velocity of the drift of other points in the last observed frame [m/s].

        Args:
            positions: the model's positions of the observed points [m].
            others: the model's positions of the other points, in the same frames [m].
        """
        kicks = self._fitted(positions, self._kicks(positions)).reshape(-1, 6).sum(axis=0)
        return self.sigma * np.einsum("a,avi->vi", kicks, self._kicks(positions, others).moves[-1])

    def log_likelihood(self, positions: Positions) -> float:
        """Log-likelihood of the residuals, the kicks integrated out, up to a constant; Huber's loss."""
        kicks = self._kicks(positions)
        fitted = self._fitted(positions, kicks)
        residuals, _, slopes = self._by_kicks(self.seen, kicks.moved(positions, fitted), kicks)
        loss = huber_loss(residuals, self.robust_scales)
        return -loss - 0.5 * float(fitted @ fitted) - 0.5 * Elimination.of(slopes.gram()).log_determinant

    def _kicks(self, positions: np.ndarray, others: np.ndarray | None = None, kicked: int | None = None) -> _Kicks:
        """Displacements of the points, or of others, by the kicks of the first `kicked` frames, each of size q."""
        count, centre = len(positions), positions.mean(axis=1, keepdims=True)
        radius = float(np.sqrt(np.square(positions[0] - centre[0]).sum(-1).mean()))
        arms = (positions if others is None else others) - centre
        ahead = np.arange(count)[:, None] - np.arange(self.begin, kicked or count) + 0.5
        moves = [np.broadcast_to(axis, arms.shape) for axis in np.eye(3)]
        moves += [np.cross(axis, arms) / radius for axis in np.eye(3)]
        return _Kicks(np.where(ahead > 0, ahead, 0.0) * self.interval * self.sigma, np.stack(moves, axis=1))

    def _by_kicks(
        self, seen: Observations, moved: np.ndarray, kicks: _Kicks, tangents: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, _Slopes]:
        """Residuals [N], derivatives by the parameters [N, K] and by the kicks, at the moved points.

        A residual depends on kicks only by the six rigid motions of its own frame, unless nuisances couple frames.
        """
        alone = not _couples_frames(seen)
        fields = kicks.moves if alone else kicks.fields()
        both = fields if tangents is None else np.concatenate([tangents, fields], axis=1)
        residuals, jacobian = seen.linearise(moved, both)
        by_parameters, by_fields = np.split(jacobian, [both.shape[1] - fields.shape[1]], axis=1)
        times, frames = (kicks.times, seen.frames) if alone else (np.ones((1, 1)), np.zeros(len(residuals), int))
        return (
            residuals,
            by_parameters,
            _Slopes(times, by_fields, [np.flatnonzero(frames == t) for t in range(len(times))]),
        )

    def _fitted(self, positions: np.ndarray, kicks: _Kicks) -> np.ndarray:
        """The most likely kicks, in units of q. Followed points and outlines find them first, as pixels see only near
        ones. Those of the last positions are kept, since rendered pixels make them slow."""
        if self._last and np.array_equal(self._last[0], positions):
            return self._last[1]
        found = np.zeros(kicks.count)
        if self.begun is not None and len(self.begun) == kicks.count:
            found = self.begun
        far = _far_seeing(self.seen)
        if far is not None:
            seen, chosen = far
            found = self._settled(seen, positions[:, chosen], replace(kicks, moves=kicks.moves[:, :, chosen]), found)
        found = self._settled(self.seen, positions, kicks, found)
        self._last[:] = [positions, found]
        return found

    def _settled(self, seen: Observations, positions: np.ndarray, kicks: _Kicks, found: np.ndarray) -> np.ndarray:
        """Gauss–Newton steps from given kicks; outlines are found again in the first steps only.

        Derivatives are kept while steps shrink fast: those of rendered pixels cost several images each.
        """
        limits, drawn, last = seen.robust_scales, seen, np.inf
        slopes: _Slopes | None = None
        for turn in range(_TURNS if kicks.count else 0):
            moved = kicks.moved(positions, found)
            if turn < _DRAWN:
                drawn = with_drawn_outlines(seen, moved)
            if slopes is None:
                residuals, _, slopes = self._by_kicks(drawn, moved, kicks)
            else:
                residuals = drawn.residuals(moved)
            weights = huber_weights(residuals, limits)
            gradient = slopes.across((weights * residuals)[:, None])[:, 0] + found
            change = np.linalg.solve(slopes.gram(weights) + np.eye(len(found)), gradient)
            found, size = found - change, float(np.abs(change).max())
            if size < _SETTLED:
                break
            if size > _SLOW * last:
                slopes = None
            last = size
        return found


def _couples_frames(seen: Observations) -> bool:
    """Whether residuals of a frame depend on the others: nuisances of camera and clock are eliminated."""
    if isinstance(seen, MarginalObservations):
        return True
    return isinstance(seen, WrappedObservations) and _couples_frames(seen.seen)


def _far_seeing(seen: Observations) -> tuple[Observations, np.ndarray] | None:
    """The observations without rendered pixels, and the indices of their points; None if that leaves all or nothing."""
    if isinstance(seen, MarginalObservations):
        part = _far_seeing(seen.seen)
        if part is None or not isinstance(part[0], StackedObservations):
            return None
        return replace(seen, seen=part[0]), part[1]
    if not isinstance(seen, StackedObservations):
        return None
    kept = [not isinstance(part, PhotometricObservations) for part in seen.parts]
    if all(kept) or not any(kept):
        return None
    pairs = [(part, where) for part, where, keep in zip(seen.parts, seen.point_slices, kept, strict=True) if keep]
    chosen = np.concatenate([np.arange(where.start, where.stop) for _, where in pairs])
    return StackedObservations(tuple(part for part, _ in pairs)), chosen


@dataclass(frozen=True, eq=False)
class _Kicks:
    """Rigid displacements by kicks.

    Attributes:
        times: the six rigid motions in each frame by a kick of each frame, shape [T, C/6].
        moves: displacements of the points by the six, shape [T, 6, P, 3].
    """

    times: np.ndarray
    moves: np.ndarray

    @property
    def count(self) -> int:
        """C, of kicks: six in each frame."""
        return 6 * self.times.shape[1]

    def fields(self) -> Float[np.ndarray, "T C P 3"]:
        """Displacements by each kick [m]."""
        fields = self.times[:, :, None, None, None] * self.moves[:, None]
        return fields.reshape(len(fields), -1, *self.moves.shape[2:])

    def moved(self, points: np.ndarray, kicks: np.ndarray) -> np.ndarray:
        """The points [T, P, 3] after kicks [C]."""
        amounts = self.times @ kicks.reshape(-1, 6)  # [T, 6]
        return np.asarray(points + np.einsum("ta,tapi->tpi", amounts, self.moves))


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives N of residuals by kicks, [N, C]: of residual n in frame t by kick (k, a), times[t, k] fields[n, a].

    Attributes:
        times: shape [T, K].
        fields: shape [N, A].
        rows: the residuals of each frame.
    """

    times: np.ndarray
    fields: np.ndarray
    rows: list[np.ndarray]

    def gram(self, weights: np.ndarray | None = None) -> Float[np.ndarray, "C C"]:
        """Nᵀ diag(weights) N."""
        parts = [self.fields[rows] for rows in self.rows]
        weighted = (
            parts if weights is None else [f * weights[r][:, None] for f, r in zip(parts, self.rows, strict=True)]
        )
        blocks = np.stack([a.T @ b for a, b in zip(weighted, parts, strict=True)])
        count = self.times.shape[1] * self.fields.shape[1]
        return np.einsum("tk,tl,tab->kalb", self.times, self.times, blocks, optimize=True).reshape(count, count)

    def across(self, columns: Float[np.ndarray, "N K"]) -> Float[np.ndarray, "C K"]:
        """Nᵀ times the columns."""
        blocks = np.stack([self.fields[rows].T @ columns[rows] for rows in self.rows])
        return np.einsum("tk,tac->kac", self.times, blocks).reshape(-1, columns.shape[1])

    def along(self, kicks: Float[np.ndarray, "C K"]) -> Float[np.ndarray, "N K"]:
        """N times kicks."""
        amounts = np.einsum("tk,kac->tac", self.times, kicks.reshape(self.times.shape[1], -1, kicks.shape[1]))
        out = np.zeros((len(self.fields), kicks.shape[1]))
        for rows, amount in zip(self.rows, amounts, strict=True):
            out[rows] = self.fields[rows] @ amount
        return out


def likely_drift(
    seen: Observations,
    positions: Positions,
    begin: int,
    interval: float,
    *,
    most: float,
    workers: Workers | None = None,
) -> RigidDriftObservations | None:
    """The observations with the most likely drift for the model's positions; None if that is zero.

    Args:
        seen: the observations, without drift.
        positions: the model's positions of the points [m].
        begin: frame of the first contact.
        interval: time between frames [s].
        most: largest q that is tried [m/s].
        workers: try several at once.
    """
    if begin >= len(positions):
        return None
    trials = [RigidDriftObservations(seen, begin, interval, share * most) for share in (0.0, *_SHARES)]
    likelihood = partial(RigidDriftObservations.log_likelihood, positions=positions)
    likelihoods = (workers or Workers()).map(likelihood, trials)
    best = int(np.argmax(likelihoods))
    return trials[best] if best else None


def model_drift(
    one: Float[np.ndarray, "T P 3"], other: Float[np.ndarray, "T P 3"], begin: int, interval: float
) -> float:
    """Size of the rigid drift between two models: rms of the kicks in each axis [m/s].

    Args:
        one, other: positions of the same points [m].
        begin: frame of the first contact.
        interval: time between frames [s].
    """
    gaps = np.array([_rigid_gap(a, b) for a, b in zip(one, other, strict=True)])
    kicks = np.diff(gaps, n=2, axis=0, prepend=np.zeros((1, 6)))[max(begin - 1, 0) :] / interval
    return float(np.sqrt(np.square(kicks).mean())) if kicks.size else 0.0


def _rigid_gap(one: np.ndarray, other: np.ndarray) -> Float[np.ndarray, " 6"]:
    """Displacement, and rotation vector times the radius of gyration, that align `one` best with `other` [m]."""
    centres = one.mean(axis=0), other.mean(axis=0)
    arms = one - centres[0]
    turn = Rotation.from_matrix(best_rotation(one, other))
    return np.concatenate([centres[1] - centres[0], np.sqrt(np.square(arms).sum(-1).mean()) * turn.as_rotvec()])
