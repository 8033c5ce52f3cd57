"""The benchmark of `physconvex evaluate paper`: textured objects moved by the FEM, filmed, truth apart from captures.

    OUT/benchmark.json                    options, objects
    OUT/captures/NAME/                    a capture with the front camera alone, mesh.obj
    OUT/first_frames/NAME/                all cameras at t = 0 (images with alpha), mesh.obj
    OUT/truth/NAME/truth.json             parameters, errors of mesh and step
    OUT/truth/NAME/CAMERA.mp4             what every camera would have seen, before white
    OUT/truth/NAME/points.npz             `rest` [P, 3], `positions` [T, P, 3] m, and `positions_CHANGE` of each change

An object is left out of a run that finds its truth.json: stop and start again as you like.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

from data_gen.benchmark_scenes import (
    DENSITY,
    FRICTION,
    MOTIONS,
    Motion,
    MotionName,
    motion_of,
    placed,
    rolled,
    scene_of,
)
from data_gen.objects.library import ObjectMesh
from data_gen.objects.user_meshes import load_user_mesh, objects_from_folder
from data_gen.still_captures import FLAT, StillViews, rendered_frames, still_cameras, write_still_capture
from data_gen.surface import Surface
from physconvex import __version__
from physconvex.camera import Camera
from physconvex.capture import Capture, Floor, save_capture
from physconvex.errors import InputError
from physconvex.fem import Embedding, Scene, TetMesh
from physconvex.fem.mesh_volume import enclosed_volume
from physconvex.fem.meshing import tetrahedralize
from physconvex.fem.surface_distance import overlap
from physconvex.identify.changes import changed, changes_of
from physconvex.reconstruction import psnr, structural_similarity
from physconvex.video import write_video

__all__ = ["BenchmarkOptions", "drop_object", "generate_benchmark"]

POINTS = 300
BENCHMARK = "benchmark.json"


@dataclass(frozen=True)
class BenchmarkOptions:
    """Sizes of the benchmark; the defaults are those of the issue's tables.

    Attributes:
        count: number of objects.
        names: of the objects' folders; None: evenly spread over the alphabet.
        size: of the square images [pixels].
        views: cameras around.
        frames, observed_frames, fps: of the motion.
        nodes: most nodes of the truth's quadratic mesh.
        steps_per_frame: of the truth.
        checked: state what half the nodes and half the steps change.
        seed: of everything random.
        log10_modulus, poisson_ratio, damping_time: ranges [log10 Pa], [-], [s, log-uniform].
        object_size: largest edge [m].
        motion: "drop": let fall on a rough floor; "toss": thrown up spinning, without a floor.
    """

    count: int = 12
    names: tuple[str, ...] | None = None
    size: int = 448
    views: int = 12
    frames: int = 24
    observed_frames: int = 16
    fps: float = 24.0
    nodes: int = 1500
    steps_per_frame: int = 32
    checked: bool = True
    seed: int = 0
    log10_modulus: tuple[float, float] = (4.0, 7.0)
    poisson_ratio: tuple[float, float] = (0.2, 0.49)
    damping_time: tuple[float, float] = (5e-4, 2e-3)
    object_size: float = 1.0
    motion: MotionName = "drop"

    def __post_init__(self) -> None:
        least = {"count": 1, "size": 64, "views": 2, "observed_frames": 2, "nodes": 50, "steps_per_frame": 1}
        for name, bound in least.items():
            if getattr(self, name) < bound:
                raise InputError(f"{name}: got {getattr(self, name)}; expected at least {bound}")
        if self.motion not in MOTIONS:
            raise InputError(f"motion: got {self.motion!r}; expected one of {', '.join(MOTIONS)}")
        if self.observed_frames > self.frames:
            raise InputError(f"observed_frames: got {self.observed_frames}; expected at most frames = {self.frames}")


def generate_benchmark(
    objects: Path,
    out: Path,
    options: BenchmarkOptions | None = None,
    *,
    only: Sequence[str] | None = None,
    on_object: Callable[[str], None] | None = None,
) -> list[str]:
    """Make (or finish) the benchmark.

    Args:
        objects: folder of folders, each with a textured mesh.
        out: the benchmark's folder.
        options: sizes.
        only: those of its objects that are to be made now, the same as they would be among all; None: all.
        on_object: told the name of each object when it is there.

    Returns:
        The objects' names.

    Raises:
        InputError: too few objects, an unknown one, one without colours, or `out` holds a benchmark of other options.
    """
    options = options or BenchmarkOptions()
    paths = _chosen(objects, options)
    unknown = sorted(set(only or ()) - set(paths))
    if unknown:
        raise InputError(f"only: {', '.join(unknown)}: not in the benchmark; expected some of {', '.join(paths)}")
    claim = {"options": _plain(options), "objects": list(paths), "version": __version__}
    out.mkdir(parents=True, exist_ok=True)
    held = out / BENCHMARK
    if held.exists() and json.loads(held.read_text(encoding="utf-8")) != claim:
        raise InputError(f"{out}: holds a benchmark of other objects or options; choose another folder")
    held.write_text(json.dumps(claim, indent=1) + "\n", encoding="utf-8")
    for number, (name, path) in enumerate(paths.items()):
        if only and name not in only:
            continue
        if not (out / "truth" / name / "truth.json").exists():
            _make(out, name, path, options, np.random.default_rng([options.seed, number]))
        if on_object is not None:
            on_object(name)
    return list(only or paths)


def drop_object(
    folder: Path, mesh: Path, truth: dict[str, float], options: BenchmarkOptions, rng: np.random.Generator
) -> tuple[Path, np.ndarray]:
    """One object dropped and filmed from the front, unless it is there.

    Args:
        folder: of the capture; the motion is stored beside it, as `NAME_motion.npz`.
        mesh: a textured mesh.
        truth: youngs_modulus [Pa], poisson_ratio, damping_time [s].
        options: sizes.
        rng: how the object is turned.

    Returns:
        The folder, and the positions [m] of the mesh's vertices at the frames, shape [T, V, 3].
    """
    kept = folder.parent / f"{folder.name}_motion.npz"
    if not kept.exists():
        body = placed(load_user_mesh(mesh), options.object_size, rng)
        grid = _meshed(body, options.nodes)
        moved = Embedding.of_points(grid, body.vertices).apply(_rolled(scene_of(grid, truth, body, Motion()), options))
        camera = _cameras(moved, options)[0]
        white, mask = _filmed(body, moved, camera)
        _write_capture(folder, body, camera, white, mask, options, Motion())
        np.savez_compressed(kept, moved=moved)
    with np.load(kept, allow_pickle=False) as archive:
        return folder, archive["moved"]


def _filmed(body: ObjectMesh, moved: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The object before white [T, H, W, 3], and where it is seen [T, H, W]."""
    surface = Surface(body.vertices, body.faces, colors=body.vertex_colors, uv=body.uv, texture=body.texture)
    frames = np.stack(rendered_frames(surface, camera, FLAT, moved))
    alpha = frames[..., 3:].astype(np.float32) / 255
    white = (frames[..., :3] * alpha + 255 * (1 - alpha)).round().astype(np.uint8)
    return white, frames[..., 3] > 127


def _plain(options: BenchmarkOptions) -> Any:
    return json.loads(json.dumps(asdict(options)))


def _chosen(folder: Path, options: BenchmarkOptions) -> dict[str, Path]:
    found = {path.parent.name: path for path in objects_from_folder(folder)}
    if options.names is not None:
        missing = [name for name in options.names if name not in found]
        if missing:
            raise InputError(f"names: {missing} are not in {folder}; expected some of {sorted(found)}")
        return {name: found[name] for name in options.names}
    if len(found) < options.count:
        raise InputError(f"objects: {folder} holds {len(found)} meshes; expected at least count = {options.count}")
    names = sorted(found)
    places = np.linspace(0, len(names) - 1, options.count).round().astype(int)
    return {names[k]: found[names[k]] for k in places}


def _make(out: Path, name: str, path: Path, options: BenchmarkOptions, rng: np.random.Generator) -> None:
    body = placed(load_user_mesh(path), options.object_size, rng)
    truth = {
        "youngs_modulus": float(10 ** rng.uniform(*options.log10_modulus)),
        "poisson_ratio": float(rng.uniform(*options.poisson_ratio)),
        "damping_time": float(np.exp(rng.uniform(*np.log(options.damping_time)))),
    }
    mesh = _meshed(body, options.nodes)
    motion = motion_of(options.motion, (options.frames - 1) / options.fps, rng)
    scene = scene_of(mesh, truth, body, motion)
    positions = _rolled(scene, options)
    surface = Embedding.of_points(mesh, body.vertices)
    moved = surface.apply(positions)
    cameras = _cameras(moved, options)
    front = _write_pictures(out, name, body, moved, cameras, options, motion)
    chosen = np.sort(rng.choice(len(body.vertices), min(POINTS, len(body.vertices)), replace=False))
    arrays = {"rest": body.vertices[chosen], "positions": moved[:, chosen]}
    for change in changes_of(scene):
        again = _rolled(changed(scene, change), options)
        arrays[f"positions_{change}"] = surface.apply(again)[:, chosen]
    folder = out / "truth" / name
    np.savez_compressed(folder / "points.npz", **arrays)  # type: ignore[arg-type]
    stated = {**truth, "density": DENSITY, "nodes": len(mesh.vertices), "licence": body.licence}
    if enclosed_volume(body.vertices, body.faces) is not None:
        stated["overlap"] = overlap(mesh, body.vertices, body.faces)
    stated |= {"friction": FRICTION} if motion.floor else {}
    if options.checked:
        stated |= _errors(body, truth, mesh, moved, (cameras[0], front), options, motion)
    (folder / "truth.json").write_text(json.dumps(stated, indent=1) + "\n", encoding="utf-8")


def _meshed(body: ObjectMesh, nodes: int) -> TetMesh:
    """Quadratic tetrahedra that are the body that is shown, as well as that many nodes can be."""
    return tetrahedralize((body.vertices, body.faces), max_nodes=nodes, order=2, method="auto", thorough=True)


def _rolled(scene: Scene, options: BenchmarkOptions, *, share: float = 1.0) -> np.ndarray:
    return rolled(scene, options.frames, options.fps, max(1, round(share * options.steps_per_frame)))


def _errors(
    body: ObjectMesh,
    truth: dict[str, float],
    mesh: TetMesh,
    moved: np.ndarray,
    front: tuple[Camera, np.ndarray],
    options: BenchmarkOptions,
    motion: Motion,
) -> dict[str, Any]:
    """How far the truth is from itself with half the steps and with half the nodes, by frame.

    Rms distance [m] of the surface, and PSNR [dB] and SSIM of the front view's pictures (`front`: camera and frames):
    what nobody can exceed by much who does not have this very mesh.
    """
    coarse = _meshed(body, options.nodes // 2)
    camera, seen = front
    out: dict[str, Any] = {}
    for label, grid, share in (("half_steps", mesh, 0.5), ("half_nodes", coarse, 1.0)):
        scene = scene_of(grid, truth, body, motion)
        other = Embedding.of_points(grid, body.vertices).apply(_rolled(scene, options, share=share))
        out[f"rms_to_{label}_m"] = np.sqrt(np.square(other - moved).sum(-1).mean(-1)).tolist()
        drawn, _ = _filmed(body, other, camera)
        pairs = [[torch.as_tensor(x / np.float32(255)) for x in both] for both in zip(drawn, seen, strict=True)]
        out[f"psnr_to_{label}"] = [psnr(a, b) for a, b in pairs]
        out[f"ssim_to_{label}"] = [float(structural_similarity(a, b)) for a, b in pairs]
    return out


def _cameras(moved: np.ndarray, options: BenchmarkOptions) -> list[Camera]:
    """Cameras about all of the motion; the first is the front one."""
    views = StillViews(options.views, (12.0, 28.0, 4.0), name="view")
    return still_cameras(moved.reshape(-1, 3), views, options.size)


def _write_pictures(
    out: Path,
    name: str,
    body: ObjectMesh,
    moved: np.ndarray,
    cameras: list[Camera],
    options: BenchmarkOptions,
    motion: Motion,
) -> np.ndarray:
    """What all cameras saw, the capture and the first frames; returns the frames of the front view [T, H, W, 3]."""
    truth = out / "truth" / name
    truth.mkdir(parents=True, exist_ok=True)
    front, mask = _filmed(body, moved, cameras[0])
    for camera in cameras:
        white = front if camera is cameras[0] else _filmed(body, moved, camera)[0]
        write_video(truth / f"{camera.name}.mp4", white, fps=options.fps, crf=6)
    if not (out / "captures" / name).exists():
        _write_capture(out / "captures" / name, body, cameras[0], front, mask, options, motion)
    (truth / "cameras.json").write_text(json.dumps([c.to_json() for c in cameras], indent=1) + "\n", encoding="utf-8")
    if not (out / "first_frames" / name).exists():
        (out / "first_frames").mkdir(exist_ok=True)
        write_still_capture(out / "first_frames" / name, body, (), size=options.size, lighting=FLAT, cameras=cameras)
    return front


def _write_capture(
    folder: Path,
    body: ObjectMesh,
    camera: Camera,
    video: np.ndarray,
    mask: np.ndarray,
    options: BenchmarkOptions,
    motion: Motion,
) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    capture = Capture(
        folder,
        options.fps,
        options.frames,
        options.observed_frames,
        cameras=(camera,),
        density=DENSITY,
        floor=Floor(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=FRICTION) if motion.floor else None,
        initial_velocity=np.array(motion.velocity),
        initial_angular_velocity=np.array(motion.spin),
    )
    rest = trimesh.Trimesh(body.vertices, body.faces, process=False)
    save_capture(capture, videos={camera.name: video}, masks={camera.name: mask}, mesh=rest, crf=6)
