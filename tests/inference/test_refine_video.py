"""From a made video of one camera, without tracks, to E; the mask's outline beside the followed points."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from inference import RefineOptions, refine, write_refinement
from inference.refinement.appearance import fitted_field
from physconvex import InputError
from physconvex.convex import read_ply
from physconvex.identify import FitOptions, Nuisance, ReducedModel, TwinOptions, base_twin, cast_camera_rays
from physconvex.io import Capture, Floor, Tracks, load_capture, look_at, save_capture
from physconvex.mesh import TetMesh, box_mesh

FRAMES, OBSERVED = 7, 6
TRUTH = {"log10_youngs_modulus": np.log10(2e4), "poisson_ratio": 0.38, "damping_time": 1e-3}
FEW = {
    "weights": 3,
    "steps_per_frame": 4,
    "correction": False,
    "model_error": False,
    "field_budget": 300,
    "field_steps": 6,
}


def texture(points):
    """Smooth colours fixed to the body."""
    waves = np.random.default_rng(2).normal(scale=40.0, size=(3, 12, 3))
    phases = np.random.default_rng(3).uniform(0, 6, size=(3, 12))
    return 128 + 18 * np.stack([np.sin(points @ w.T + p).sum(-1) for w, p in zip(waves, phases, strict=True)], axis=-1)


RATE, FINER = 48.0, 4  # frames per second, and states of the motion per frame
CAMERA = look_at((0.55, -1.0, 0.45), (0.15, 0.1, 0.02), width=192, height=128, vertical_field_of_view=0.42)
BOX = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1)
TETS = TetMesh(BOX.vertices + np.array([0, 0, 0.012]), BOX.tets)
FINE = box_mesh((0.3, 0.2, 0.1), (9, 6, 3), order=1)
USED, FACES = np.unique(FINE.boundary_faces, return_inverse=True)
REST, FACES = FINE.vertices[USED] + np.array([0, 0, 0.012]), FACES.reshape(-1, 3)


def capture_of(folder, fps, frames, observed, camera):
    floor = Floor(np.zeros(3), np.array([0.1, 0.05, 1.0]), friction=0.3)
    still = {"initial_velocity": np.array([0.0, 0.0, -0.8]), "initial_angular_velocity": np.zeros(3)}
    return Capture(folder, fps, frames, observed, (camera,), floor=floor, **still)


def filmed(folder, states, *, told=CAMERA, shown="painted", tracks=None):
    """The capture of states of the body, one per frame, seen by the camera and said to be seen by another one.

    The body is "painted", "plain" (of one colour) or shown by its "masks" alone. Markers may be seen besides.
    """
    images, masks = [], []
    for x in states:
        hits = cast_camera_rays(CAMERA, x, FACES)
        seen = hits.faces >= 0
        paint = np.full(3, 90.0) if shown == "plain" else texture(np.nan_to_num(hits.on(REST, FACES)))
        picture = np.where(seen[..., None], paint, 235)
        images.append(picture.clip(0, 255).astype(np.uint8))
        masks.append(seen)
    films = {"masks": {"front": np.stack(masks)}}
    if shown != "masks":
        films["videos"] = {"front": np.stack(images)}
    surface = trimesh.Trimesh(REST, FACES, process=False)
    capture = capture_of(folder, RATE, FRAMES, OBSERVED, told)
    save_capture(capture, tets=TETS, mesh=surface, tracks=tracks, crf=8, **films)
    return folder


def refined(folder, **options):
    start = {"log10_youngs_modulus": 4.1, "poisson_ratio": 0.3}
    return refine(folder, options=RefineOptions(initial=start, **FEW, field=False, **options))


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    """A box that falls on a tilted floor, moved by the reduced model with three weights: four states per frame."""
    count = FINER * FRAMES
    plain = capture_of(tmp_path_factory.mktemp("moved") / "plain", FINER * RATE, count, count, CAMERA)
    save_capture(plain, tets=TETS)
    twin = base_twin(plain, TwinOptions(weights=3, steps_per_frame=1))
    return ReducedModel(twin, tuple(TRUTH), REST, count).positions(np.array(list(TRUTH.values())))


@pytest.fixture(scope="module")
def folder(motion, tmp_path_factory):
    """Its film before a plain background."""
    return filmed(tmp_path_factory.mktemp("video") / "seen", motion[::FINER])


@pytest.mark.slow
def test_one_camera_is_enough(folder, tmp_path):
    stages = []
    start = {"log10_youngs_modulus": 4.1, "poisson_ratio": 0.3}
    options = RefineOptions(initial=start, **FEW)
    found = refine(folder, out=tmp_path, options=options, on_stage=lambda name, _: stages.append(name))
    fits = ["points", "reduced", "anchored", "reduced_again", "colours_1.5"]
    assert stages == [*fits, "motion", "field"]
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.05)
    assert found["poisson_ratio"].value == pytest.approx(TRUTH["poisson_ratio"], abs=0.06)
    assert len(found.sources) == 2 and "colours of" in found.sources[0] and "outline points" in found.sources[1]
    assert np.isnan(found.future_rms)
    write_refinement(found, tmp_path, pictures=False)
    field = read_ply(tmp_path / "field.ply")
    assert found.appearance is not None and len(field) == len(found.appearance.field) > 50
    moved = found.appearance.at(FRAMES - 1).points.mean((0, 1)) - field.points.mean((0, 1))
    body = found.motion.vertices[-1].mean(0) - found.motion.vertices[0].mean(0)
    np.testing.assert_allclose(moved.numpy(), body, atol=0.01)
    told = found.to_json()["convex_field"]["splitting"]
    assert told["given"] <= told["merged"] <= told["split"] and told["used"] == (told["gain_db"] > 0)
    assert len(field) == (told["merged"] if told["used"] else told["given"])
    assert told["off_affine_m"] <= told["off_affine_given_m"]
    picture, alpha = found.appearance.image(2, load_capture(folder).cameras[0])
    assert picture.shape == (128, 192, 3) and 0.02 < alpha.mean() < 0.6


@pytest.mark.slow
def test_the_convex_twin_alone_tells_the_material_from_the_pixels(folder, tmp_path, monkeypatch):
    """Stages of the quick answer, which continues from what is stored, and its rows."""
    stages = []
    start = {"log10_youngs_modulus": 4.5, "poisson_ratio": 0.3}
    options = RefineOptions(initial=start, **FEW | {"field_budget": 600, "field_steps": 40}, convex=True)
    options = options.replace(stop_after="convex", pixels=(24, 48, 96))
    found = refine(folder, out=tmp_path, options=options, on_stage=lambda *stage: stages.append(stage))
    names = [
        "points",
        "reduced",
        "field",
        "convex_basis",
        "convex_start",
        "convex_24",
        "convex_48",
        "convex_96",
        "convex_motion",
    ]
    assert stages == [(name, False) for name in names]
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.1)
    assert found["poisson_ratio"].value == pytest.approx(TRUTH["poisson_ratio"], abs=0.1)
    assert len(found.sources) == 3 and found.sources[2].endswith(" pixels")
    (row,) = found.stages
    assert row.name == "convex twin" and row.log10_youngs_modulus == found["log10_youngs_modulus"].value
    low, high = row.intervals[0]
    assert low < TRUTH["log10_youngs_modulus"] < high
    assert found.to_json()["stages"]["convex twin"]["poisson_ratio"]["value"] == row.poisson_ratio
    again = []
    refine(folder, out=tmp_path, options=options, on_stage=lambda *stage: again.append(stage))
    assert all(stored for _, stored in again)
    further = []
    refine(
        folder, out=tmp_path, options=options.replace(stop_after=None),
        on_stage=lambda *stage: further.append(stage),
    )  # fmt: skip
    assert ("convex_96", True) in further and ("motion", False) in further  # nothing is fitted twice
    other = box_mesh((0.3, 0.2, 0.1), (3, 1, 1), order=1)  # meshers may make another mesh in another run
    with monkeypatch.context() as patch:
        patch.setattr(Capture, "tets", lambda _: TetMesh(other.vertices + np.array([0, 0, 0.012]), other.tets))
        (tmp_path / "stages" / "convex_motion.npz").unlink()
        assert refine(folder, out=tmp_path, options=options)["poisson_ratio"].value == found["poisson_ratio"].value
    with pytest.raises(InputError, match="stop_after is 'convex', but there is no video with masks, or no convex"):
        refine(folder, options=options.replace(field=False))


@pytest.mark.slow
def test_the_network_of_the_weights_is_fitted_to_the_pixels(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("inference.refinement.convex_stage._OPTIONS", FitOptions(max_iterations=3))
    start = {"log10_youngs_modulus": 4.4, "poisson_ratio": 0.35}
    options = RefineOptions(initial=start, **FEW, stop_after="convex", basis="neural", fit_weights=1)
    stages = []
    found = refine(folder, out=tmp_path, options=options, on_stage=lambda *stage: stages.append(stage))
    assert [name for name, _ in stages[-4:]] == ["convex_24", "convex_weights_0", "convex_turn_0", "convex_motion"]
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.3)
    with pytest.raises(InputError, match="fit_weights: got 1 with basis 'elastic'; expected basis 'neural'"):
        RefineOptions(fit_weights=1)


@pytest.mark.slow
def test_markers_and_videos_are_fitted_together(motion, tmp_path):
    some, states, rng = slice(None, None, 40), motion[::FINER], np.random.default_rng(0)
    seen = states[:, some] + rng.normal(scale=1e-3, size=states[:, some].shape)
    tracks = Tracks(REST[some], seen, np.full(seen.shape[:2], 1e-3))
    folder = filmed(tmp_path / "seen", states, tracks=tracks)
    alone, both = (refined(folder, observations=kind) for kind in ("tracks", "both"))
    assert [line.split()[-1] for line in (*alone.sources, *both.sources)] == 2 * ["markers"] + 2 * ["points"]
    assert both["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.03)
    assert both["log10_youngs_modulus"].noise_sigma < 0.5 * alone["log10_youngs_modulus"].noise_sigma
    assert len(both.residual_rms) == 3 and both.residual_rms[both.sources[0]] == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("left_out", ["points", "outlines", "colours"])
def test_the_convex_twin_does_without_one_kind_of_observations(folder, left_out):
    start = {"log10_youngs_modulus": 4.5, "poisson_ratio": 0.3}
    options = RefineOptions(initial=start, **FEW | {"field_budget": 600, "field_steps": 40}, convex=True)
    options = options.replace(stop_after="convex", **{left_out: False})
    found = refine(folder, options=options)
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.12)
    kinds = {"points": " points, ", "outlines": " outline points", "colours": " pixels"}
    assert len(found.sources) == 2
    assert not any(kinds[left_out] in source for source in found.sources)


def test_without_points_outlines_are_needed(folder):
    with pytest.raises(InputError, match="points: are off, and camera 'front' has no outlines"):
        refine(folder, options=RefineOptions(points=False, outlines=False, start="scan", **FEW))


@pytest.mark.slow
@pytest.mark.parametrize("shown", ["plain", "masks"])
def test_outlines_alone_will_do(motion, shown, tmp_path):
    """A body without texture, or without any image, could not be refined at all."""
    seen, stages = filmed(tmp_path / "seen", motion[::FINER], shown=shown), []
    options = RefineOptions(start="scan", **FEW)
    found = refine(seen, out=tmp_path / "out", options=options, on_stage=lambda name, _: stages.append(name))
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.1)
    assert len(found.sources) == 1 and "outline points" in found.sources[0]
    assert not {"anchored", "colours_1.5"} & {*stages}
    assert any("no point of the object can be followed" in line for line in found.warnings) == (shown == "plain")
    assert (found.appearance is not None) == (shown == "plain")
    write_refinement(found, tmp_path / "out")
    assert (tmp_path / "out" / "side_by_side.mp4").stat().st_size > 1000
    with pytest.raises(InputError, match=r"no point of the object|no such file"):
        refine(seen, options=options.replace(outlines=False))


@pytest.mark.slow
def test_a_late_clock_is_found_beside_the_material(motion, tmp_path):
    late = filmed(tmp_path / "late", np.concatenate([motion[:1], motion[FINER + 1 :: FINER]]))
    believed, found = (refined(late, nuisance=Nuisance(time_offset=sigma)) for sigma in (0.0, 0.01))
    assert found.nuisances["time_offset [s]"] == pytest.approx(1 / (FINER * RATE), rel=0.1)
    errors = [one["log10_youngs_modulus"].value - TRUTH["log10_youngs_modulus"] for one in (believed, found)]
    assert errors[0] > 0.08 and abs(errors[1]) < 0.5 * errors[0]


@pytest.mark.slow
def test_a_camera_that_is_turned_otherwise_than_told_is_found(motion, tmp_path):
    turn, pose = np.array([0.003, 0.01, 0.0]), CAMERA.transform_matrix.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    seen = filmed(tmp_path / "turned", motion[::FINER], told=replace(CAMERA, transform_matrix=pose))
    found = refined(seen, nuisance=Nuisance(camera_rotation=0.02))
    back = [found.nuisances[f"front/rotation_{axis} [rad]"] for axis in "xyz"]
    np.testing.assert_allclose(back, -turn, atol=1.5e-3)
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.05)


@pytest.mark.gpu
def test_the_field_is_fitted_on_a_gpu_as_on_the_processor(folder):
    found = [fitted_field(load_capture(folder), RefineOptions(device=name, **FEW)) for name in ("cpu", "cuda")]
    here, there = found
    assert here["points"].shape == there["points"].shape
    np.testing.assert_allclose(there["psnr"], here["psnr"], atol=0.1)
    assert here["psnr"].min() > 15


def test_a_camera_that_is_not_there_is_named(folder):
    with pytest.raises(InputError, match="expected one of \\['front'\\]"):
        refine(folder, options=RefineOptions(cameras=("side",), start="scan", **FEW))
    with pytest.raises(InputError, match=r"tracks\.npz"):
        refine(folder, options=RefineOptions(observations="tracks", start="scan", **FEW))


@pytest.mark.slow
def test_pictures_alone_give_the_modulus(motion, tmp_path):
    """No mesh: frame 0 from ten sides, then one video. The body, its motion and E come from the pictures."""
    images_only = filmed(tmp_path / "seen", motion[::FINER])
    for name in ("mesh.obj", "tets.npz"):
        (images_only / name).unlink()
    content = json.loads((images_only / "capture.json").read_text())
    del content["floor"]["friction"]
    centre = REST.mean(axis=0)
    for k in range(9):
        angle, up = 2 * np.pi * k / 9, (0.0, 0.6, -0.4)[k % 3]
        way = np.array([np.cos(angle) * np.cos(up), np.sin(angle) * np.cos(up), np.sin(up)])
        camera = look_at(way + centre, centre, width=160, height=160, vertical_field_of_view=0.42, name=f"s{k}")
        hits = cast_camera_rays(camera, motion[0], FACES)
        paint = texture(np.nan_to_num(hits.on(REST, FACES))).clip(0, 255)
        alpha = np.where(hits.faces >= 0, 255.0, 0.0)
        rgba = np.concatenate([paint, alpha[..., None]], axis=-1).astype(np.uint8)
        Image.fromarray(rgba).save(images_only / f"{camera.name}.png")
        content["cameras"].append(camera.to_json())
    (images_only / "capture.json").write_text(json.dumps(content))
    stages: list[str] = []
    start = {"log10_youngs_modulus": 4.1, "poisson_ratio": 0.3}
    usual = {"field_budget": None, "field_steps": None}  # of the reconstruction
    options = RefineOptions(initial=start, **(FEW | usual), field=False)
    found = refine(images_only, out=tmp_path / "out", options=options, on_stage=lambda name, _: stages.append(name))
    assert stages[0] == "reconstruction"
    body = trimesh.load(tmp_path / "out" / "reconstruction" / "body.ply")
    assert body.volume == pytest.approx(0.3 * 0.2 * 0.1, rel=0.04)
    assert found["log10_youngs_modulus"].value == pytest.approx(TRUTH["log10_youngs_modulus"], abs=0.1)
    assert found["poisson_ratio"].value == pytest.approx(TRUTH["poisson_ratio"], abs=0.1)
    row = found.to_json()["reconstruction"]
    assert row["views"] == 10 and row["volume"] == pytest.approx(body.volume) and row["psnr"] > 20
    assert 0.0 < found["log10_youngs_modulus"].geometry_error < 0.1  # stated apart, within the interval
    assert found["log10_youngs_modulus"].sigma > found["log10_youngs_modulus"].geometry_error
    friction = found["friction"]  # what is not stated of the floor is unknown, not zero
    assert friction.prior == (0.4, 0.3) and any("does not state the friction" in told for told in found.warnings)
    height = found["floor_height"]  # known within the error of the body, which decides when it lands
    assert height.prior is not None and height.prior[0] == 0.0 and 5e-4 < height.prior[1] < 0.01
    assert abs(height.value) < 2 * height.prior[1]
