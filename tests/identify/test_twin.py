"""The base twin says what the capture says: geometry, world, boundary, initial motion."""

import numpy as np
import pytest
import trimesh

from physconvex import InputError
from physconvex.dynamics import Timing, simulate
from physconvex.fem import ElasticBody
from physconvex.identify import (
    MarkerObservations,
    ReducedModel,
    TwinOptions,
    WeightedObservations,
    base_twin,
    clamp_of,
    coarse_mesh,
    default_parameters,
    frame_errors,
    mesh_of_capture,
    start_motion,
    twin,
    with_free_friction,
    with_weights,
)
from physconvex.io import Boundary, Capture, Floor, Tracks, load_capture, save_capture
from physconvex.mesh import TetMesh, box_mesh, to_quadratic
from physconvex.reduced import eigenmode_weights

SIZE = (0.2, 0.05, 0.05)
BOX = np.array([[-1e-6, -1.0, -1.0], [1e-6, 1.0, 1.0]])


STILL = {"initial_velocity": np.zeros(3), "initial_angular_velocity": np.zeros(3)}


def saved(folder, *, boundary=None, geometry=True, **changes):
    box = box_mesh(SIZE, (4, 1, 1), order=1)
    capture = Capture(folder, 50.0, 4, 3, **changes)
    tracks = Tracks(np.zeros((1, 3)), np.zeros((4, 1, 3)), np.full((4, 1), 1e-3))
    save_capture(capture, tets=box if geometry else None, tracks=tracks, boundary=boundary)
    return load_capture(folder)


def test_a_mesh_that_is_hardly_the_body_has_no_coarser_one(tmp_path, monkeypatch):
    shown = box_mesh(SIZE, (4, 1, 1), order=1)
    capture = Capture(tmp_path / "c", 50.0, 4, 3)
    tracks = Tracks(np.zeros((1, 3)), np.zeros((4, 1, 3)), np.full((4, 1), 1e-3))
    save_capture(capture, mesh=trimesh.Trimesh(*shown.surface, process=False), tracks=tracks)
    capture = load_capture(tmp_path / "c")
    few = box_mesh(SIZE, (4, 1, 1))
    monkeypatch.setattr(twin, "mesh_of_capture", lambda capture, **_: few)
    fine = box_mesh(SIZE, (8, 2, 2))
    assert coarse_mesh(capture, fine, max_nodes=50) is few
    thick = TetMesh(fine.vertices * np.array([1.0, 1.0, 1.5]), fine.tets)  # a third of it is not the body
    assert coarse_mesh(capture, thick, max_nodes=50) is thick


def test_world_and_boundary_go_to_both_models(tmp_path):
    floor = Floor(np.array([0, 0, -0.1]), np.array([0.0, 0.1, 1.0]), friction=0.4)
    stated = {"density": 700.0, "gravity": np.array([0, 1.0, -9.0]), "floor": floor}
    twin = base_twin(saved(tmp_path / "c", boundary=Boundary(clamped_box=BOX), **stated), TwinOptions(weights=2))
    assert twin.mesh.order == 2 and twin.steps_per_frame == 8  # 384 per second at 50 frames per second
    reduced, full = twin.scene, twin.full_scene()
    for scene in (reduced, full):
        assert scene.body.total_mass == pytest.approx(700 * np.prod(SIZE))
        assert scene.gravity == (0.0, 1.0, -9.0)
        assert scene.obstacles[0].friction == 0.4
        np.testing.assert_allclose(scene.obstacles[0].point, [0, 0, -0.1])
    held = twin.mesh.vertices[full.held.nodes]
    assert len(held) == 9 and np.abs(held[:, 0]).max() == 0
    np.testing.assert_allclose(np.sort(reduced.pins.points, axis=0), np.sort(held, axis=0))
    assert reduced.pins.areas.sum() > 0.9 * SIZE[1] * SIZE[2]
    assert [p.name for p in default_parameters(twin)] == ["log10_youngs_modulus", "poisson_ratio"]


def test_few_weights_follow_a_clamped_body_since_they_are_of_its_own_vibrations(tmp_path):
    twin = base_twin(saved(tmp_path / "c", boundary=Boundary(clamped_box=BOX)), TwinOptions(weights=6))
    timing = Timing(frames=6, fps=48.0, steps_per_frame=4)
    truth = simulate(twin.full_scene(), timing).positions

    def distance(trial) -> float:
        return float(np.linalg.norm(simulate(trial.scene, timing).positions(twin.mesh.vertices) - truth))

    assert distance(twin) < 0.1 * distance(with_weights(twin, eigenmode_weights(ElasticBody(twin.mesh), 6)))
    assert base_twin(twin.capture, TwinOptions(weights=64)).scene.body.space.field.count < 64  # the mesh has no more
    assert base_twin(saved(tmp_path / "free"), TwinOptions(weights=7)).scene.body.space.field.count == 7


def test_another_mesh_is_held_at_the_same_place(tmp_path):
    twin = base_twin(saved(tmp_path / "c", boundary=Boundary(clamped_box=BOX)), TwinOptions(weights=2))
    finer = box_mesh(SIZE, (6, 2, 2))
    scene = twin.full_scene(finer)
    assert np.abs(finer.vertices[scene.held.nodes, 0]).max() == 0 and len(scene.held.nodes) == 25
    np.testing.assert_allclose(scene.start, finer.vertices, atol=1e-12)


def test_held_vertices_hold_the_middles_between_them_and_follow_a_motion():
    coarse = box_mesh(SIZE, (4, 1, 1), order=1)
    held = np.flatnonzero(coarse.vertices[:, 0] == 0)
    times = np.arange(5) / 50.0
    motion = coarse.vertices[held] + np.array([0, 0, 1.0])[None, None] * (times**2)[:, None, None]
    boundary = Boundary(clamped_vertices=held, motion=motion)
    clamp = clamp_of(boundary, to_quadratic(coarse), reference=coarse.vertices, fps=50.0)
    assert len(clamp.nodes) == 9
    rest = clamp.mesh.vertices[clamp.nodes]
    np.testing.assert_allclose(clamp.motion(0.03), rest + np.array([0, 0, 0.03**2]), atol=1e-9)
    assert clamp.springs().motion(0.03).shape == clamp.springs().points.shape


def test_a_boundary_that_holds_nothing_is_refused(tmp_path):
    mesh = box_mesh(SIZE, (4, 1, 1))
    nowhere = Boundary(clamped_box=BOX + 5.0)
    with pytest.raises(InputError, match="holds no node"):
        clamp_of(nowhere, mesh, reference=mesh.vertices, fps=50.0)
    with pytest.raises(InputError, match="expected indices below"):
        clamp_of(Boundary(clamped_vertices=np.array([10**6])), mesh, reference=mesh.vertices, fps=50.0)


def test_points_alone_are_no_body(tmp_path):
    with pytest.raises(InputError, match="no rest geometry"):
        mesh_of_capture(saved(tmp_path / "c", geometry=False))


def test_what_is_not_stated_is_free_and_starts_where_the_markers_say(tmp_path):
    twin = base_twin(saved(tmp_path / "c"), TwinOptions(weights=2))
    names = [p.name for p in default_parameters(twin, damping=True, fixed=["poisson_ratio"])]
    assert names[:2] == ["log10_youngs_modulus", "damping_time"] and len(names) == 2 + 6
    velocity, spin = np.array([0.3, -0.2, 0.5]), np.array([0.5, 1.0, -0.8])
    points = np.random.default_rng(0).uniform(size=(10, 3)) * SIZE
    center, frames = np.array(SIZE) / 2, []
    for time in np.arange(4) / 50.0:
        turned = points + np.cross(spin * time, points - center)
        frames.append(turned + velocity * time + 0.5 * np.array([0, 0, -9.81]) * time**2)
    seen = MarkerObservations(points, np.stack(frames), np.full((4, 10), 1e-3))
    started = start_motion(twin, seen).scene
    np.testing.assert_allclose(started.initial_velocity, velocity, atol=1e-3)
    np.testing.assert_allclose(started.initial_angular_velocity, spin, atol=1e-2)


def test_priors_friction_and_contradictions(tmp_path):
    twin = base_twin(saved(tmp_path / "c"), TwinOptions(weights=2))
    (modulus, ratio, *_) = default_parameters(twin, priors={"poisson_ratio": (0.45, 0.01)})
    assert (ratio.prior_mean, ratio.prior_sigma) == (0.45, 0.01) and modulus.prior_sigma == np.inf
    with pytest.raises(InputError, match="both free and fixed"):
        default_parameters(twin, free=["density"], fixed=["density"])
    with pytest.raises(InputError, match="is not free"):
        default_parameters(twin, priors={"density": (1000.0, 10.0)})
    with pytest.raises(InputError, match="no floor"):
        with_free_friction(twin)


def test_free_friction_has_derivatives_at_its_lowest_value(tmp_path):
    """A fit that reached zero friction ended with an error, since a frictionless floor has no such parameter."""
    floor = Floor(np.array([0, 0, -0.001]), np.array([0.0, 0.0, 1.0]))
    twin = with_free_friction(
        base_twin(saved(tmp_path / "c", floor=floor, **STILL), TwinOptions(weights=1, steps_per_frame=2))
    )
    (friction,) = default_parameters(twin, free=["friction"], fixed=["log10_youngs_modulus", "poisson_ratio"])
    model = ReducedModel(twin, ("friction",), np.zeros((1, 3)), 2)
    positions, tangents = model.linearise(np.array([friction.lower]))
    assert np.isfinite(tangents).all() and positions.shape == (2, 1, 3)


def test_frames_that_the_model_does_not_know_count_less():
    points = np.zeros((2, 3))
    seen = MarkerObservations(points, np.zeros((3, 2, 3)), np.full((3, 2), 0.1))
    coarse = np.ones((3, 2, 3))
    fine = coarse + np.array([0.0, 0.1, 0.3])[:, None, None]
    errors = frame_errors(seen, fine, coarse)
    np.testing.assert_allclose(errors, [0, 1, 3])
    weighted = WeightedObservations.by_errors(seen, errors)
    np.testing.assert_allclose(weighted.residuals(coarse)[::6], 10 / np.sqrt([1, 2, 10]))
    residuals, jacobian = weighted.linearise(coarse, np.ones((3, 1, 2, 3)))
    np.testing.assert_allclose(jacobian[:, 0], residuals)  # both are ten times the factor
    assert weighted.in_frames(2).residuals(coarse).shape == (12,)


def test_meshes_of_a_surface_are_filled_on_request(tmp_path):
    """And so are those with fewer nodes beside them; tetrahedra that a capture has are the body as they are."""
    capture = Capture(tmp_path / "c", 50.0, 4, 3)
    tracks = Tracks(np.zeros((1, 3)), np.zeros((4, 1, 3)), np.full((4, 1), 1e-3))
    ball = trimesh.creation.icosphere(3, 0.1)
    save_capture(capture, mesh=ball, tracks=tracks)
    capture = load_capture(tmp_path / "c")
    plain, filled = (base_twin(capture, TwinOptions(weights=2, max_nodes=400, fill=fill)) for fill in (False, True))
    assert plain.mesh.filling is None
    assert filled.mesh.filling is not None
    coarse = coarse_mesh(capture, filled.mesh, max_nodes=100)
    assert len(coarse.vertices) < len(filled.mesh.vertices)
    assert coarse.filling is not None
    assert filled.full_scene(coarse).body.total_mass == pytest.approx(1000 * ball.volume, rel=1e-2)
    whole = saved(tmp_path / "tets")
    assert base_twin(whole, TwinOptions(weights=2, fill=True)).mesh.filling is None
