"""The measured silicone cantilever of Dubied et al. 2022: sag under its own weight and 102 g, free oscillation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh

from docs.figures.fem_cases.beams import DATA, clamp, edge_load
from physconvex.dynamics import Loads, Timing, simulate
from physconvex.fem import ElasticBody, Scene, solve_static, tangent_stiffness
from physconvex.mesh import Embedding

__all__ = [
    "LOAD",
    "MARKERS",
    "Recording",
    "Release",
    "first_frequency",
    "held_zero_scatter",
    "marker_displacement",
    "oscillation_frequency",
    "recording",
    "release",
    "static_state",
]

LOAD = 1.00062  # N
GRAVITY = (0.0, 0.0, -9.80709)
# the authors' nominal marker positions in the beam frame [m]: 6 mm off the surface
MARKERS = np.array([[0.0, 0.015, 0.036], [0.0, -0.006, 0.024], [0.0, 0.036, 0.006]])
RELEASE_SPEED = 0.02  # m/s of the first tip marker, above which the beam has been let go


@dataclass(frozen=True)
class Recording:
    """Marker tracks: times [T] s; tip and base markers [T, 3, 3] m (frame, marker, axial-lateral-up)."""

    times: np.ndarray
    tips: np.ndarray
    bases: np.ndarray

    @property
    def release_frame(self) -> int:
        """First frame in which the beam falls."""
        speed = np.abs(np.gradient(self.tips[:, 0, 2], self.times))
        return int(np.argmax(speed > RELEASE_SPEED))

    def held(self, tracks: np.ndarray) -> np.ndarray:
        """Mean positions while the beam is held straight [3, 3]: up to 0.2 s before the release."""
        return tracks[: self.release_frame - 20].mean(axis=0)

    def at_rest(self, tracks: np.ndarray) -> np.ndarray:
        """Mean positions over the last half second [3, 3]."""
        return tracks[-50:].mean(axis=0)

    def sag(self) -> np.ndarray:
        """Displacement of the tip markers from held to rest [3, 3] m."""
        return self.at_rest(self.tips) - self.held(self.tips)


def recording(name: str) -> Recording:
    """The recording "gravity" (own weight) or "load101" (102 g more)."""
    table = np.genfromtxt(DATA / "srl_silicone_beam" / f"beam_{name}_V2_a.csv", delimiter=",", names=True)

    def tracks(kind: str) -> np.ndarray:
        axes = ("axial", "lateral", "up")
        return np.stack([np.stack([table[f"{kind}_{i}_{a}_m"] for a in axes], -1) for i in (1, 2, 3)], 1)

    return Recording(table["t_s"], tracks("Tip"), tracks("Base"))


def held_zero_scatter() -> float:
    """How far the hand-held zero differs between the two recordings [m].

    The frame is fixed to the tip markers as held. The base markers do not move during a recording, so the difference of
    their height between the recordings is a difference of the height at which the tip was held.
    """
    base = [run.held(run.bases)[:, 2] for run in (recording("gravity"), recording("load101"))]
    return float(np.abs((base[1] - base[0]).mean()))


# --- simulation


def static_state(body: ElasticBody, load: float = 0.0) -> np.ndarray:
    """Positions at rest under the body's weight and a load [N] on the top edge of the free end."""
    forces = Loads(body.mesh.vertices, edge_load(body.mesh, (0, 0, -load))) if load else None
    scene = Scene(body, gravity=GRAVITY, node_pins=clamp(body), loads=forces)
    return solve_static(scene, load_steps=2 if load else 1)


def marker_displacement(body: ElasticBody, positions: np.ndarray) -> np.ndarray:
    """Displacement of the tip markers [..., 3, 3] m for node positions [..., V, 3].

    A marker moves rigidly with the surface: with the displacement and the rotation (polar decomposition of the mean
    deformation gradient) of the material within 5 mm of the point below it.
    """
    mesh = body.mesh
    feet = np.clip(MARKERS, (-0.1, 0.0, 0.0), (0.0, 0.03, 0.03))
    carried = Embedding.of_points(mesh, feet).apply(positions)
    out = np.empty((*positions.shape[:-2], 3, 3))
    for marker, foot in enumerate(feet):
        near = np.linalg.norm(mesh.vertices - foot, axis=1) < 0.0101
        rest = mesh.vertices[near] - mesh.vertices[near].mean(0)
        now = positions[..., near, :] - positions[..., near, :].mean(-2, keepdims=True)
        u, _, vt = np.linalg.svd(np.swapaxes(now, -1, -2) @ rest)
        offset = np.einsum("...ij,j->...i", u @ vt, MARKERS[marker] - foot)
        out[..., marker, :] = carried[..., marker, :] + offset - MARKERS[marker]
    return out


def first_frequency(body: ElasticBody, positions: np.ndarray, *, tip_mass: float = 0.0) -> float:
    """Lowest frequency [Hz] of small vibrations about the given state; `tip_mass` [kg] sits on the loaded edge."""
    free = np.ones(len(body.mesh.vertices), dtype=bool)
    free[clamp(body).nodes] = False
    stiffness = tangent_stiffness(body, positions, free=free)
    mass = body.mass + sp.diags(edge_load(body.mesh, (0, 0, tip_mass))[:, 2])
    mass = sp.kron(mass.tocsr()[free][:, free], sp.eye(3))
    start = np.ones(stiffness.shape[0])
    value = eigsh(stiffness.tocsc(), k=1, M=mass.tocsc(), sigma=0.0, v0=start, return_eigenvectors=False)[0]
    return float(np.sqrt(value) / (2 * np.pi))


def oscillation_frequency(times: np.ndarray, heights: np.ndarray, rest: float, periods: int = 5) -> float:
    """Frequency [Hz] over so many full periods after the first crossing of the rest height (linear interpolation)."""
    z = heights - rest
    crossings = np.flatnonzero(z[:-1] * z[1:] < 0)
    at = times[crossings] + (times[crossings + 1] - times[crossings]) * z[crossings] / (z[crossings] - z[crossings + 1])
    return float(periods / (at[2 * periods] - at[0]))


@dataclass(frozen=True)
class Release:
    """Simulated fall from straight: times [T] s and displacements of the tip markers [T, 3, 3] m."""

    times: np.ndarray
    markers: np.ndarray


def release(body: ElasticBody, *, seconds: float, damping_time: float, steps_per_frame: int = 5) -> Release:
    """Let go from straight under its own weight, frames at 100 Hz."""
    scene = Scene(body, gravity=GRAVITY, node_pins=clamp(body), damping_time=damping_time)
    run = simulate(scene, Timing(frames=round(100 * seconds) + 1, fps=100, steps_per_frame=steps_per_frame))
    return Release(run.times, marker_displacement(body, run.positions))
