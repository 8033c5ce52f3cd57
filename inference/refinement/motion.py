"""The fitted model in all frames: surface, markers, handles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from inference.refinement.stages import Arrays, RefinementRun
from physconvex.dynamics import simulate
from physconvex.identify import Fit, FullModel, Twin, enriched, extrapolated_nodes
from physconvex.io import Capture
from physconvex.mesh import Embedding, TetMesh


@dataclass(frozen=True, eq=False)
class RefinedMotion:
    """The motion of the fitted model in all frames, future ones included.

    Attributes:
        times: [s], shape [T].
        vertices: of the surface [m], shape [T, V, 3].
        faces: of the surface, shape [F, 3].
        markers: of the tracked points [m], shape [T, P, 3]; P = 0 without tracks.
        handles: Z_m(t) of the reduced model, φ = X + Σ W_m Z_m [X; 1], shape [T, M + 1, 3, 4].
        weight_points, weights: rest positions [m], shape [N, 3], and skinning weights, shape [N, M], of the mesh nodes.
        model: "full" or "reduced": the model that gives vertices and markers.
        mesh, nodes: the mesh of that model at rest, and its nodes [m], shape [T, K, 3].
        reduced_gap: rms distance [m] of the reduced model to it with its first weights, and with those refined by the
            full model's motion, whose handles these are; empty without the full model.
    """

    times: Float[np.ndarray, " T"]
    vertices: Float[np.ndarray, "T V 3"]
    faces: Int[np.ndarray, "F 3"]
    markers: Float[np.ndarray, "T P 3"]
    handles: Float[np.ndarray, "T K 3 4"]
    weight_points: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, "N M"]
    model: str
    mesh: TetMesh
    nodes: Float[np.ndarray, "T K 3"]
    reduced_gap: tuple[float, ...] = ()


def refined_motion(run: RefinementRun, full: FullModel, found: Fit, *, mesh: TetMesh | None = None) -> RefinedMotion:
    """Roll the fitted model out over all frames: the full one if the correction is on, else the reduced one.

    Args:
        run: the refinement.
        full: the full model, on any mesh.
        found: the fit.
        mesh: of the full model, if it is not the twin's.
    """
    capture, options = run.capture, run.options
    twin = full.twin
    body = mesh if options.correction and mesh is not None else twin.mesh

    fitted, nodes = twin.with_values(found.names, found.values), twin.mesh.vertices

    def compute() -> Arrays:
        reduced = simulate(fitted.scene, twin.timing())
        if not options.correction:
            moved, handles = reduced.positions(nodes), reduced.handles()
            return {"nodes": moved, "handles": handles, "weights": _weights(twin), "gap": np.zeros(0)}
        coarse = replace(full, frames=capture.frames)
        moved = extrapolated_nodes(coarse, replace(coarse, mesh=mesh), found.values)
        carried = Embedding.of_points(body, nodes).apply(moved)
        better = enriched(fitted, carried)
        again = simulate(better.scene, twin.timing())
        gap = np.array([_rms(r.positions(nodes) - carried) for r in (reduced, again)])
        nearer, moving = (better, again) if gap[1] < gap[0] else (fitted, reduced)
        return {"nodes": moved, "handles": moving.handles(), "weights": _weights(nearer), "gap": gap}

    arrays = run.stages.run("motion" if options.stop_after is None else f"{options.stop_after}_motion", compute)
    vertices, markers = shown(capture, twin, body, arrays["nodes"])
    return RefinedMotion(
        times=capture.times,
        vertices=vertices,
        faces=twin.surface[1],
        markers=markers,
        handles=arrays["handles"],
        weight_points=nodes,
        weights=arrays["weights"],
        model="full" if options.correction else "reduced",
        mesh=body,
        nodes=arrays["nodes"],
        reduced_gap=tuple(map(float, arrays["gap"])),
    )


def shown(
    capture: Capture, twin: Twin, mesh: TetMesh, nodes: Float[np.ndarray, "T K 3"]
) -> tuple[Float[np.ndarray, "T V 3"], Float[np.ndarray, "T P 3"]]:
    """Positions of the surface's vertices and of the tracked points in a moved mesh [m]."""
    vertices, tracks = twin.surface[0], capture.tracks()
    markers = np.zeros((0, 3)) if tracks is None else tracks.rest
    moved = Embedding.of_points(mesh, np.concatenate([vertices, markers])).apply(nodes)
    return moved[:, : len(vertices)], moved[:, len(vertices) :]


def _weights(twin: Twin) -> np.ndarray:
    return twin.scene.body.space.field.at(twin.mesh.vertices)[0]


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.square(difference).sum(-1).mean()))


def future_rms(capture: Capture, motion: RefinedMotion) -> float:
    """Root mean square distance of the markers in the frames after the fitted ones [m]; NaN without any."""
    tracks = capture.tracks()
    if tracks is None or capture.observed_frames >= capture.frames:
        return float("nan")
    ahead = slice(capture.observed_frames, None)
    distance = np.linalg.norm(motion.markers[ahead] - tracks.positions[ahead], axis=-1)
    return float(np.sqrt(np.nanmean(distance**2))) if np.isfinite(distance).any() else float("nan")
