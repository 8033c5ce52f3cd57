"""The fitted model in all frames: surface, markers, handles."""

from __future__ import annotations

import numpy as np

from inference.refining.options import RefineOptions
from inference.refining.result import RefinedMotion
from inference.refining.stages import Stages
from physconvex.capture import Capture
from physconvex.fem import TetMesh
from physconvex.identify import Fit, FullModel, Twin
from physconvex.reduced import simulate

__all__ = ["future_rms", "motion_of", "surface_of_capture"]


def surface_of_capture(capture: Capture, twin: Twin) -> tuple[np.ndarray, np.ndarray]:
    """Rest vertices [V, 3] m and triangles [F, 3] of the surface: of the capture's mesh, else of the tetrahedra."""
    mesh = capture.mesh()
    if mesh is not None:
        return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    used, faces = np.unique(twin.mesh.boundary_faces[:, :3], return_inverse=True)
    return twin.mesh.vertices[used], faces.reshape(-1, 3)


def motion_of(
    capture: Capture, twin: Twin, found: Fit, options: RefineOptions, stages: Stages, *, mesh: TetMesh | None = None
) -> RefinedMotion:
    """Roll the fitted model out over all frames: the full one where the correction is on, else the reduced one.

    Args:
        capture, twin, found, options, stages: of the refinement.
        mesh: of the full model, if it is not the twin's.
    """
    vertices, faces = surface_of_capture(capture, twin)
    tracks = capture.tracks()
    markers = np.zeros((0, 3)) if tracks is None else tracks.rest

    def compute() -> dict[str, np.ndarray]:
        scene = twin.with_values(found.names, found.values).scene
        run = simulate(scene, **twin.timing())
        points = np.concatenate([vertices, markers])
        if options.correction:
            moved = FullModel(twin, found.names, points, capture.frames, mesh).positions(found.values)
        else:
            moved = run.positions(points)
        return {"moved": moved, "handles": run.handles()}

    arrays = stages.run("motion", compute)
    nodes = twin.mesh.vertices
    return RefinedMotion(
        times=capture.times,
        vertices=arrays["moved"][:, : len(vertices)],
        faces=faces,
        markers=arrays["moved"][:, len(vertices) :],
        handles=arrays["handles"],
        weight_points=nodes,
        weights=twin.scene.body.space.field.at(nodes)[0],
        model="full" if options.correction else "reduced",
    )


def future_rms(capture: Capture, motion: RefinedMotion) -> float:
    """Root mean square distance of the markers in the frames that were not fitted [m]; NaN without any."""
    tracks = capture.tracks()
    if tracks is None or capture.observed_frames >= capture.frames:
        return float("nan")
    ahead = slice(capture.observed_frames, None)
    distance = np.linalg.norm(motion.markers[ahead] - tracks.positions[ahead], axis=-1)
    return float(np.sqrt(np.nanmean(distance**2))) if np.isfinite(distance).any() else float("nan")
