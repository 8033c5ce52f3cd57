"""Which mesher `method="auto"` takes, by what a mesh shares with the body."""

import numpy as np
import pytest
import trimesh

from physconvex import ConvergenceError, InputError
from physconvex.mesh import (
    TetMesh,
    box_mesh,
    enclosed_volume,
    meshing,
    overlap,
    tetrahedralize,
    with_merged_vertices,
    with_volume,
)
from physconvex.mesh.mesh_cache import cached_or_made
from physconvex.mesh.surfaces import simplified_within, surface_distance, with_fewer_triangles

SIZE = (0.4, 0.2, 0.1)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("PHYSCONVEX_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def box():
    shown = trimesh.creation.box(SIZE)
    return np.asarray(shown.vertices) + 0.5 * np.array(SIZE), np.asarray(shown.faces)


@pytest.fixture(scope="module")
def table():
    """A slab on four thin legs."""
    cells = np.zeros((12, 7, 9), bool)
    cells[..., -2:] = True
    for x in (slice(0, 2), slice(-2, None)):
        for y in (slice(0, 2), slice(-2, None)):
            cells[x, y] = True
    corners = np.array(list(np.ndindex(2, 2, 2)))
    quads = []
    for index in np.argwhere(cells):
        for axis in range(3):
            for side in (0, 1):
                beyond = index + (2 * side - 1) * np.eye(3, dtype=int)[axis]
                if not ((beyond >= 0).all() and (beyond < cells.shape).all() and cells[tuple(beyond)]):
                    quad = index + corners[corners[:, axis] == side]
                    quads.append(quad[[0, 2, 3, 1] if side != (axis == 1) else [0, 1, 3, 2]])
    vertices, faces = np.unique(np.concatenate(quads), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 4)
    return 0.04 * vertices, np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def stretched(x=1.0, y=1.0, z=1.0):
    mesh = box_mesh(SIZE, (2, 1, 1), order=1)
    return TetMesh(mesh.vertices * np.array([x, y, z]), mesh.tets)


def test_overlap_is_the_common_volume_over_that_of_both(box):
    assert overlap(stretched(), *box) == pytest.approx(1.0, abs=0.005)
    assert overlap(stretched(x=0.5), *box) == pytest.approx(0.5, abs=0.01)
    assert overlap(stretched(z=2.0), *box) == pytest.approx(0.5, abs=0.01)


def test_a_body_with_legs_keeps_them(table):
    with pytest.raises(ConvergenceError):
        tetrahedralize(table, method="lattice", max_nodes=400, order=2)
    best = tetrahedralize(table, method="auto", max_nodes=400, order=2)
    assert overlap(best, *table) > 0.8
    assert len(best.vertices) <= 400 and best.order == 2
    assert best.volume == pytest.approx(enclosed_volume(*table), rel=1e-3)
    again = tetrahedralize(table, method="auto", max_nodes=400, order=2)
    np.testing.assert_array_equal(again.vertices, best.vertices)
    few = tetrahedralize(table, method="simplified", max_nodes=250, order=2)  # fTetWild alone: .75
    assert len(few.vertices) <= 250 and overlap(few, *table) > 0.9


@pytest.mark.parametrize(
    ("made", "best", "runs"), [((0.8, 0.95), 0.95, 2), ((0.8, 0.85, 0.8, 0.7, 0.95), 0.85, 4), ((0.95,), 0.95, 1)]
)
def test_a_simplified_surface_that_is_filled_badly_is_filled_again(box, monkeypatch, made, best, runs):
    """fTetWild gives another mesh each time, of a slab on legs now and then one with less than .9 of it."""
    todo = list(made)
    monkeypatch.setattr(meshing, "with_fewer_triangles", lambda vertices, faces, count: (vertices, faces))
    monkeypatch.setattr(meshing, "fill", lambda *arguments: stretched(x=todo.pop(0)))
    mesh = tetrahedralize(box, method="simplified", max_nodes=500, order=1)
    np.testing.assert_array_equal(mesh.vertices, with_volume(stretched(x=best), enclosed_volume(*box)).vertices)
    assert len(made) - len(todo) == runs


def test_a_mesh_that_had_too_many_nodes_by_chance_is_tried_again(box, monkeypatch):
    """Coarser ones stay worse, however often they are made."""
    asked, fine = [], box_mesh(SIZE, (4, 4, 4), order=1)
    todo = [fine, stretched(x=0.8), fine, stretched(x=0.85), stretched(x=0.95)]
    monkeypatch.setattr(
        meshing, "with_fewer_triangles", lambda vertices, faces, count: asked.append(count) or (vertices, faces)
    )
    monkeypatch.setattr(meshing, "fill", lambda *arguments: todo.pop(0))
    mesh = tetrahedralize(box, method="simplified", max_nodes=100, order=1)
    np.testing.assert_array_equal(mesh.vertices, with_volume(stretched(x=0.95), enclosed_volume(*box)).vertices)
    finest, coarser = asked[:2]
    assert coarser < finest and asked == [finest, coarser, finest, coarser, finest]


def test_ways_are_tried_until_one_is_good_enough(box, monkeypatch):
    made = {"lattice": stretched(x=0.95), "ftetwild": stretched(x=0.85), "simplified": stretched(x=0.97)}
    tried = []

    def way(name):
        def make(*args, **options):
            tried.append(name)
            if isinstance(made[name], Exception):
                raise made[name]
            return made[name]

        return make

    for name, function in (
        ("lattice", "_lattice_mesh"),
        ("ftetwild", "fill_within"),
        ("simplified", "_simplified_mesh"),
    ):
        monkeypatch.setattr(meshing, function, way(name))

    def length(**options):
        tried.clear()
        return tetrahedralize(box, method="auto", **options).vertices[:, 0].max() / SIZE[0]

    assert length() == pytest.approx(0.95) and tried == ["lattice"]
    assert length(thorough=True) == pytest.approx(0.97) and tried == ["lattice", "ftetwild", "simplified"]
    made["lattice"] = stretched(x=0.7)
    assert length() == pytest.approx(0.85) and tried == ["lattice", "ftetwild"]
    assert length() == pytest.approx(0.85) and tried == [], "what is kept is looked for first"
    made["ftetwild"] = stretched(x=0.6)
    assert length(max_nodes=300) == pytest.approx(0.97) and tried == ["lattice", "ftetwild", "simplified"]
    made.update(lattice=ConvergenceError("no"), ftetwild=InputError("the second"), simplified=InputError("the third"))
    with pytest.raises(InputError, match="the second"):
        length(max_nodes=301)


def test_a_mesh_is_kept_for_its_surface_and_settings(box, cache):
    made = []

    def make():
        made.append(stretched(x=1.0 + 0.1 * len(made)))
        return made[-1]

    first = cached_or_made(box, (1, "a"), make)
    np.testing.assert_array_equal(cached_or_made(box, (1, "a"), make).vertices, first.vertices)
    assert len(made) == 1
    cached_or_made(box, (2, "a"), make)
    cached_or_made((box[0] * 2, box[1]), (1, "a"), make)
    assert len(made) == 3
    for file in (cache / "meshes").iterdir():
        file.write_bytes(file.read_bytes()[:100])  # cut short
    assert cached_or_made(box, (1, "a"), make) is made[3]


def test_of_two_that_are_made_at_once_the_first_counts(box):
    first, second = stretched(), stretched(x=1.1)

    def make():
        cached_or_made(box, "settings", lambda: first)  # another process is faster
        return second

    np.testing.assert_array_equal(cached_or_made(box, "settings", make).vertices, first.vertices)


def test_where_nothing_can_be_kept_the_mesh_is_made(box, cache):
    cache.write_text("no folder")
    mesh = stretched()
    assert cached_or_made(box, "settings", lambda: mesh) is mesh


def test_simplified_surfaces_stay_closed_and_keep_thin_parts(table):
    vertices, faces = with_fewer_triangles(*table, 120)
    assert len(faces) <= 120 < len(table[1])
    assert enclosed_volume(vertices, faces) == pytest.approx(enclosed_volume(*table), rel=0.02)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), np.ptp(table[0], axis=0), rtol=0.02)
    few = with_fewer_triangles(vertices, faces, 500)
    np.testing.assert_array_equal(few[0][few[1]], vertices[faces])


def test_seams_close(box):
    vertices, faces = box
    cut = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    closed = with_merged_vertices(*cut)
    assert len(closed[0]) == 8 and enclosed_volume(*closed) == pytest.approx(np.prod(SIZE))


def test_a_simplified_mesh_wants_a_closed_surface(box):
    with pytest.raises(InputError, match="close it"):
        tetrahedralize((box[0], box[1][1:]), method="simplified")


def test_a_dense_surface_is_simplified_before_it_is_meshed(monkeypatch):
    """It stays closed and within the distance; the mesh has the volume of the surface as it was given."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    vertices, faces = np.asarray(ball.vertices) * [1.0, 1.0, 2.0], np.asarray(ball.faces)
    fewer = simplified_within(vertices, faces, 1e-3)
    volume = enclosed_volume(vertices, faces)
    assert len(fewer[1]) < 0.5 * len(faces)
    assert enclosed_volume(*fewer) == pytest.approx(volume, rel=0.02)
    assert np.abs(surface_distance(vertices, faces)(fewer[0])).max() < 1e-3
    with pytest.raises(InputError, match="not closed"):
        simplified_within(vertices, faces[1:], 1e-3)
    given = []
    real = meshing.tetrahedralize
    monkeypatch.setattr(meshing, "_DENSE", len(faces) - 1)
    monkeypatch.setattr(meshing, "tetrahedralize", lambda pair, **how: given.append(len(pair[1])) or real(pair, **how))
    mesh = meshing.mesh_of_few_nodes(vertices, faces, max_nodes=200)
    assert max(given) < 0.5 * len(faces)
    assert enclosed_volume(*mesh.surface) == pytest.approx(volume, rel=2e-3)
