"""The benchmark of `physconvex evaluate paper`: textured objects moved by the FEM and filmed; truth in its own folder.

    OUT/benchmark.json                    options, objects
    OUT/captures/NAME/                    images alone: the video of the front camera (and of further observed ones),
                                          a picture of frame 0 of every other, all on white, with masks
    OUT/truth/NAME/truth.json             parameters, errors of mesh and step
    OUT/truth/NAME/mesh.ply               closed surface at t = 0 [m]
    OUT/truth/NAME/CAMERA.mp4             images of every camera, on white
    OUT/truth/NAME/points.npz             `rest` [P, 3], `positions` [T, P, 3] m, and `positions_CHANGE` of each change

A run skips objects whose truth.json exists, so that it can be stopped and continued at any time.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, UInt8
from pydantic import JsonValue

from data_gen.benchmark_scenes import (
    DENSITY,
    FRICTION,
    BenchmarkMotion,
    BenchmarkOptions,
    changed,
    changes_of,
    draw_motion,
    placed,
    rolled,
    scene_of,
)
from data_gen.objects.library import ObjectMesh
from data_gen.objects.user_meshes import load_user_mesh, objects_from_folder
from data_gen.still_captures import FLAT, StillViews, rendered_frames, still_cameras
from physconvex import InputError, __version__
from physconvex.fem import Scene
from physconvex.io import Camera, Capture, Floor, save_capture, write_video
from physconvex.mesh import Embedding, TetMesh, enclosed_volume, filled, overlap, tetrahedralize
from physconvex.reconstruction import psnr, structural_similarity

Film = tuple[UInt8[np.ndarray, "T H W 3"], Bool[np.ndarray, "T H W"]]  # frames, and the object's mask

POINTS = 300
BENCHMARK = "benchmark.json"


def generate_benchmark(
    objects: Path,
    out: Path,
    options: BenchmarkOptions | None = None,
    *,
    only: Sequence[str] | None = None,
    on_object: Callable[[str], None] | None = None,
) -> list[str]:
    """Make (or continue) the benchmark.

    Args:
        objects: folder of folders, each with a textured mesh.
        out: the benchmark's folder.
        options: sizes.
        only: the objects to make now, identical to those of a full run; None: all.
        on_object: called with the name of each finished object.

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
    for name, path in paths.items():
        if not (out / "truth" / name / "truth.json").exists():
            load_user_mesh(path).drawn()  # refused now, not after its simulation
    claim = {"options": options.to_json(), "objects": list(paths), "version": __version__}
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
    """One object dropped and filmed from the front, unless it exists.

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
        take = _Take(placed(load_user_mesh(mesh), options.object_size, rng), truth, BenchmarkMotion(), options)
        grid = take.mesh()
        moved = take.moved(grid, take.scene(grid))
        camera = take.cameras(moved)[0]
        take.write_capture(folder, {camera: take.filmed(moved, camera)}, mesh=take.surface)
        np.savez_compressed(kept, moved=moved)
    with np.load(kept, allow_pickle=False) as archive:
        return folder, archive["moved"]


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
    motion = draw_motion(options.motion, (options.frames - 1) / options.fps, rng)
    take = _Take(body, truth, motion, options)
    mesh = take.mesh()
    scene = take.scene(mesh)
    moved = take.moved(mesh, scene)
    cameras = take.cameras(moved)
    front = _write_pictures(out, name, take, moved, cameras)
    chosen = np.sort(rng.choice(len(body.vertices), min(POINTS, len(body.vertices)), replace=False))
    arrays = {"rest": body.vertices[chosen], "positions": moved[:, chosen]}
    for change in changes_of(scene) if options.changed else ():
        arrays[f"positions_{change}"] = take.moved(mesh, changed(scene, change))[:, chosen]
    folder = out / "truth" / name
    np.savez_compressed(folder / "points.npz", **arrays)  # type: ignore[arg-type]
    stated: dict[str, JsonValue] = {**truth, "density": DENSITY, "nodes": len(mesh.vertices), "licence": body.licence}
    if enclosed_volume(body.vertices, body.faces) is not None:
        stated["overlap"] = overlap(mesh, body.vertices, body.faces)
    stated |= {"friction": FRICTION} if motion.floor else {}
    if options.checked:
        stated |= take.errors(mesh, moved, cameras[0], front)
    (folder / "truth.json").write_text(json.dumps(stated, indent=1) + "\n", encoding="utf-8")


@dataclass(frozen=True, eq=False)
class _Take:
    """One object: its shape, material, initial motion, and all sizes."""

    body: ObjectMesh
    truth: dict[str, float]
    motion: BenchmarkMotion
    options: BenchmarkOptions

    def mesh(self, share: float = 1.0) -> TetMesh:
        """Quadratic tetrahedra that approximate the visible body as well as (a share of) that many nodes permit."""
        surface, nodes = (self.body.vertices, self.body.faces), int(share * self.options.nodes)
        mesh = tetrahedralize(surface, max_nodes=nodes, order=2, method="auto", thorough=True)
        return filled(mesh, *surface) if self.options.fill else mesh

    @property
    def surface(self) -> trimesh.Trimesh:
        """The visible surface at t = 0 [m]."""
        return trimesh.Trimesh(self.body.vertices, self.body.faces, process=False)

    def scene(self, mesh: TetMesh) -> Scene:
        """The scene on a mesh."""
        return scene_of(mesh, self.truth, self.body, self.motion)

    def moved(self, mesh: TetMesh, scene: Scene, *, share: float = 1.0) -> Float[np.ndarray, "T V 3"]:
        """The visible vertices in all frames [m], with (a share of) the time steps."""
        sizes = self.options
        nodes = rolled(scene, sizes.frames, sizes.fps, max(1, round(share * sizes.steps_per_frame)))
        return Embedding.of_points(mesh, self.body.vertices).apply(nodes)

    def cameras(self, moved: Float[np.ndarray, "T V 3"]) -> list[Camera]:
        """About all of the motion; the first is the front one."""
        views = StillViews(self.options.views, (12.0, 28.0, 4.0), name="view")
        return still_cameras(moved.reshape(-1, 3), views, self.options.size)

    def filmed(self, moved: Float[np.ndarray, "T V 3"], camera: Camera) -> Film:
        """The object on white [T, H, W, 3], and its mask [T, H, W]."""
        frames = np.stack(rendered_frames(self.body.drawn(), camera, FLAT, moved))
        alpha = frames[..., 3:].astype(np.float32) / 255
        white = (frames[..., :3] * alpha + 255 * (1 - alpha)).round().astype(np.uint8)
        return white, frames[..., 3] > 127

    def errors(
        self, mesh: TetMesh, moved: Float[np.ndarray, "T V 3"], camera: Camera, seen: np.ndarray
    ) -> dict[str, JsonValue]:
        """Differences of the truth to itself with half the steps and with half the nodes, by frame.

        Rms distance [m] of the surface, and PSNR [dB] and SSIM of the pictures `seen` by a camera: about the best
        possible result with any other mesh.
        """
        out: dict[str, JsonValue] = {}
        for label, grid, share in (("half_steps", mesh, 0.5), ("half_nodes", self.mesh(0.5), 1.0)):
            other = self.moved(grid, self.scene(grid), share=share)
            out[f"rms_to_{label}_m"] = np.sqrt(np.square(other - moved).sum(-1).mean(-1)).tolist()
            drawn, _ = self.filmed(other, camera)
            pairs = [[torch.as_tensor(x / np.float32(255)) for x in both] for both in zip(drawn, seen, strict=True)]
            out[f"psnr_to_{label}"] = [psnr(a, b) for a, b in pairs]
            out[f"ssim_to_{label}"] = [float(structural_similarity(a, b)) for a, b in pairs]
        return out

    def write_capture(self, folder: Path, films: Mapping[Camera, Film], mesh: trimesh.Trimesh | None = None) -> None:
        """What cameras see: films of all frames, or of frame 0 alone; with the initial motion, and a mesh if given."""
        folder.parent.mkdir(parents=True, exist_ok=True)
        capture = Capture(
            folder,
            self.options.fps,
            self.options.frames,
            self.options.observed_frames,
            cameras=tuple(films),
            density=DENSITY,
            floor=Floor(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=FRICTION) if self.motion.floor else None,
            initial_velocity=np.array(self.motion.velocity),
            initial_angular_velocity=np.array(self.motion.spin),
        )
        videos = {camera.name: frames for camera, (frames, _) in films.items() if len(frames) > 1}
        stills = {camera.name: frames[0] for camera, (frames, _) in films.items() if len(frames) == 1}
        masks = {camera.name: mask if len(mask) > 1 else mask[0] for camera, (_, mask) in films.items()}
        save_capture(capture, videos=videos, stills=stills, masks=masks, mesh=mesh, crf=6)


def _write_pictures(out: Path, name: str, take: _Take, moved: np.ndarray, cameras: list[Camera]) -> np.ndarray:
    """Images of all cameras, and the capture; returns the frames of the front view [T, H, W, 3]."""
    truth = out / "truth" / name
    truth.mkdir(parents=True, exist_ok=True)
    take.surface.export(truth / "mesh.ply")
    (truth / "cameras.json").write_text(json.dumps([c.to_json() for c in cameras], indent=1) + "\n", encoding="utf-8")
    observed = {k * len(cameras) // take.options.observed_views for k in range(take.options.observed_views)}
    films = {}
    for k, camera in enumerate(cameras):
        frames, mask = take.filmed(moved, camera)
        write_video(truth / f"{camera.name}.mp4", frames, fps=take.options.fps, crf=6)
        films[camera] = (frames, mask) if k in observed else (frames[:1].copy(), mask[:1].copy())
    if not (out / "captures" / name).exists():
        take.write_capture(out / "captures" / name, films)
    return films[cameras[0]][0]
