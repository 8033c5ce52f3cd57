"""Outlines tell the place of a surface to a fraction of a pixel."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from physconvex.reconstruction.carving import cell_of
from physconvex.reconstruction.outline_fit import outline_displacements
from tests.reconstruction.scenes import RADIUS, ball_mesh, speckled_ball, views

DRAWN = 1.005  # radius of the ball of convexes in pictures, of its own


def test_the_missing_displacement_of_a_ball_is_told_on_its_outlines():
    seen = views(10, size=128, field=speckled_ball())
    mesh, cell = ball_mesh(5), cell_of(seen)

    def told(factor: float) -> float:
        surface = trimesh.Trimesh(DRAWN * factor * np.asarray(mesh.vertices), mesh.faces, process=False)
        vertices = np.asarray(surface.vertices)
        towards = np.array([view.camera.position for view in seen])[None] - vertices[:, None]
        cosines = np.einsum("vi,vci->vc", surface.vertex_normals, towards) / np.linalg.norm(towards, axis=2)
        found, outlines = outline_displacements(surface, seen, np.where(cosines < -0.4, np.nan, cosines), cell=cell)
        shown = outlines > 0
        assert 0.3 < shown.mean() < 1.0 and not found[~shown].any()
        assert found[shown].std() < 0.15 * cell
        return float(found[shown].mean())

    exact = told(1.0)
    assert abs(exact) < 0.06 * cell
    for factor in (0.97, 1.02):
        assert abs(factor - 1) * RADIUS > 0.35 * cell
        assert told(factor) - exact == pytest.approx(DRAWN * (1 - factor) * RADIUS, abs=0.06 * cell)
