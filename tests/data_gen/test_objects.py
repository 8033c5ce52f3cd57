"""Procedural objects and user meshes."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from data_gen import FAMILIES, load_user_mesh, objects_from_folder, random_object
from data_gen.objects.profiles import polygon_distance
from physconvex import InputError
from physconvex.mesh import Embedding, tetrahedralize_implicit


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_objects_are_solid_closed_unit_sized_and_fit_their_distance_function(family):
    for seed in range(2):
        body = random_object(np.random.default_rng(seed), families=[family])
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.body_count == 1
        assert mesh.volume > 0.02  # outward faces
        assert body.size == pytest.approx(1.0)
        np.testing.assert_allclose(body.bounds.sum(axis=0), 0, atol=1e-9)
        assert 3500 < len(body.faces) < 7000
        assert body.family == family
        assert body.signed_distance is not None
        assert np.quantile(np.abs(body.signed_distance(body.vertices)), 0.99) < 1e-3
        inside = mesh.triangles_center - 0.01 * mesh.face_normals
        assert np.mean(body.signed_distance(inside) < 0) > 0.99


def test_objects_are_repeatable_and_differ_between_seeds():
    first, again, other = (random_object(np.random.default_rng(s)) for s in (7, 7, 8))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.faces, again.faces)
    assert first.name == again.name
    assert first.name != other.name


def test_generated_objects_can_be_meshed_and_their_surface_embedded():
    body = random_object(np.random.default_rng(2), families=["toy"]).scaled(0.2)
    mesh = tetrahedralize_implicit(
        body.signed_distance, body.bounds, surface=(body.vertices, body.faces), max_nodes=700
    )
    assert len(mesh.vertices) <= 700
    assert Embedding.of_points(mesh, body.vertices).max_distance < 0.1 * 0.2


def test_scaling_moves_surface_and_distance_function_together():
    body = random_object(np.random.default_rng(1))
    small = body.scaled(0.1)
    assert small.size == pytest.approx(0.1)
    np.testing.assert_allclose(
        small.signed_distance(small.vertices * 1.1),
        0.1 * body.signed_distance(body.vertices * 1.1),
        atol=1e-12,
    )
    with pytest.raises(InputError, match="size"):
        body.scaled(0.0)


def test_wrong_arguments_are_refused():
    with pytest.raises(InputError, match="families"):
        random_object(np.random.default_rng(0), families=["dragon"])
    with pytest.raises(InputError, match="triangles"):
        random_object(np.random.default_rng(0), triangles=3)


def test_polygon_distance_of_a_square_and_of_a_concave_outline():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    points = np.array([[0.5, 0.5], [0.9, 0.5], [2.0, 0.5], [-3.0, -4.0]])
    np.testing.assert_allclose(polygon_distance(square, points), [-0.5, -0.1, 1.0, 5.0])
    angle = np.array([[0.0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
    np.testing.assert_allclose(polygon_distance(angle, np.array([[1.5, 1.5], [0.5, 1.5]])), [0.5, -0.5])


@pytest.fixture
def folder(tmp_path):
    cube = trimesh.creation.box()
    lines = [f"v {x} {y} {z}" for x, y, z in cube.vertices] + ["vt 0 0", "vt 1 0", "vt 1 1"]
    lines += [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in cube.faces]
    (tmp_path / "cube").mkdir()
    (tmp_path / "cube" / "model.obj").write_text("\n".join(lines) + "\n")
    Image.fromarray(np.full((8, 4, 3), [200, 10, 20], dtype=np.uint8)).save(tmp_path / "cube" / "texture.png")
    (tmp_path / "LICENSE.txt").write_text("CC BY 4.0, somebody\nmore\n")
    return tmp_path


def test_user_meshes_come_with_texture_and_licence(folder):
    paths = objects_from_folder(folder)
    assert [p.name for p in paths] == ["model.obj"]
    body = load_user_mesh(paths[0])
    assert body.family == "user"
    assert body.licence == "CC BY 4.0, somebody"
    assert body.texture.shape == (8, 4, 3)
    np.testing.assert_array_equal(body.texture[0, 0], [200, 10, 20])
    assert body.uv.shape == (len(body.vertices), 2)
    assert set(map(tuple, body.uv.tolist())) == {(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)}
    assert body.size == pytest.approx(1.0)


def test_vertex_colours_of_a_ply_are_kept(tmp_path):
    mesh = trimesh.creation.box()
    mesh.visual.vertex_colors = np.tile([[10, 20, 30, 255]], (8, 1)).astype(np.uint8)
    mesh.export(tmp_path / "box.ply")
    body = load_user_mesh(tmp_path / "box.ply")
    np.testing.assert_array_equal(np.unique(body.vertex_colors, axis=0), [[10, 20, 30]])
    assert body.texture is None


def test_gltf_files_are_turned_upright(tmp_path):
    trimesh.creation.box(extents=(1.0, 3.0, 2.0)).export(tmp_path / "box.glb")
    body = load_user_mesh(tmp_path / "box.glb")
    np.testing.assert_allclose(np.ptp(body.vertices, axis=0), [1.0, 2.0, 3.0])
    assert trimesh.Trimesh(body.vertices, body.faces).volume == pytest.approx(6.0)


def test_bad_files_are_refused(folder, tmp_path):
    with pytest.raises(InputError, match="not a file"):
        load_user_mesh(tmp_path / "absent.obj")
    (tmp_path / "note.txt").write_text("hello")
    with pytest.raises(InputError, match="ends in"):
        load_user_mesh(tmp_path / "note.txt")
    (tmp_path / "broken.glb").write_bytes(b"not a mesh")
    with pytest.raises(InputError, match="cannot be read"):
        load_user_mesh(tmp_path / "broken.glb")
    (folder / "cube" / "texture.png").write_text("no picture")
    with pytest.raises(InputError, match="texture"):
        load_user_mesh(folder / "cube" / "model.obj")
    with pytest.raises(InputError, match="texture"):
        load_user_mesh(folder / "cube" / "model.obj", texture=tmp_path / "absent.png")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no mesh"):
        objects_from_folder(tmp_path / "empty")
