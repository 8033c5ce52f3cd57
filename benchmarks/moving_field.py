"""A reconstructed field that moves with a simulated body, against the textured body rendered in every frame.

A scanned object in flat light (its colours do not depend on how it turns) is reconstructed from 12 views as in
`reconstruction.py`; then dropped as a soft body (quadratic tetrahedra, 24 frames) with the field's points bound to the
tetrahedra, and seen by a camera of its own. Beside it, the same convexes moved with their centres alone: shifted, and
shifted and turned by the polar rotation, which is what a field of rigid primitives could do.

python benchmarks/moving_field.py --objects data/gso [--name Schleich_Lion_Action_Figure] [--set steps=400]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from data_gen.objects.library import ObjectMesh
from data_gen.objects.user_meshes import load_user_mesh
from data_gen.still_captures import FLAT, StillViews, rendered_frames, still_cameras, write_still_capture
from data_gen.surface import Surface
from inference.reconstruction import reconstruct
from physconvex.camera import Camera
from physconvex.contact import Plane
from physconvex.convex import BoundField, ConvexField, bind_to_tets, non_affinity, polar_rotation
from physconvex.fem import ElasticBody, Embedding, Scene, TetMesh, simulate
from physconvex.fem.meshing import tetrahedralize
from physconvex.reconstruction import load_reconstruction_config, psnr, structural_similarity
from physconvex.render import render

RESULT = Path(__file__).parent / "results" / "moving_field.json"
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "moving_field.png"
FRAMES, RATE, SIZE = 24, 60.0, 448
STIFFNESS = 15.0  # E in units of density · gravity · size
DENSITY, RATIO, GRAVITY = 1000.0, 0.4, 9.81
HEIGHT = 0.4  # of the drop, in sizes
VIEWS = (StillViews(12, (10, 35, -10), name="fit"), StillViews(4, (20, 0), phase=0.37, name="held"))


@dataclass(frozen=True)
class Frame:
    """One frame: PSNR [dB] over the whole image of the field, and of the two rigid ways; SSIM and PSNR on the object of
    the field; `deformation` is the rms distance of the surface from its best rigid fit to rest, over the size."""

    deformation: float
    field: float
    field_object: float
    field_ssim: float
    shifted: float
    shifted_and_turned: float


def placed(body: ObjectMesh) -> ObjectMesh:
    """The object with its lowest point at the height of the drop, over the origin."""
    low, high = body.bounds
    size = float((high - low).max())
    shift = np.array([-0.5 * (low + high)[0], -0.5 * (low + high)[1], HEIGHT * size - low[2]])
    return replace(body, vertices=body.vertices + shift)


def drop(body: ObjectMesh, nodes: int) -> tuple[TetMesh, np.ndarray]:
    """Rest mesh and nodal positions [T, V, 3] of the fall and bounce."""
    mesh = tetrahedralize((body.vertices, body.faces), max_nodes=nodes, order=2, method="auto")
    size = float(np.ptp(body.vertices, axis=0).max())
    modulus = STIFFNESS * DENSITY * GRAVITY * size
    elastic = ElasticBody(mesh, youngs_modulus=modulus, poisson_ratio=RATIO, density=DENSITY)
    scene = Scene(body=elastic, obstacles=(Plane(friction=0.5),), gravity=(0.0, 0.0, -GRAVITY), damping_time=5e-4)
    return mesh, simulate(scene, frames=FRAMES, fps=RATE, steps_per_frame=8).positions


def deformations(surface: np.ndarray) -> np.ndarray:
    """Rms distance from the best rigid fit (Kabsch) to the first frame, over the size, shape [T]."""
    rest = surface[0] - surface[0].mean(axis=0)
    found = []
    for places in surface:
        moved = places - places.mean(axis=0)
        left, _, right = np.linalg.svd(moved.T @ rest)
        turn = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
        found.append(np.sqrt(np.square(moved - rest @ turn.T).sum(axis=1).mean()))
    return np.array(found) / np.ptp(surface[0], axis=0).max()


def rigid(bound: BoundField, moved: ConvexField, positions: np.ndarray, *, turned: bool) -> ConvexField:
    """The convexes with their shape at rest, at their moved centres."""
    offsets = bound.field.points - bound.field.centres[:, None]
    if turned:
        gradients = np.asarray(bound.gradients @ positions).reshape(-1, 3, 3).swapaxes(1, 2)
        offsets = offsets @ polar_rotation(torch.as_tensor(gradients).to(offsets)).transpose(1, 2)
    return moved.with_points(moved.centres[:, None] + offsets)


def drawn(field: ConvexField, camera: Camera) -> torch.Tensor:
    """The image before white."""
    with torch.no_grad():
        return render(field, camera).colour.clamp(0, 1)


def main() -> None:
    """Reconstruct, simulate, compare, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True, help="folder of folders with model.obj and texture.png")
    parser.add_argument("--name", default="Schleich_Lion_Action_Figure")
    parser.add_argument("--nodes", type=int, default=900)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--set", dest="settings", nargs="*", default=[], help="settings, as steps=400")
    parser.add_argument("--work", type=Path, help="folder for the capture and the field; kept if given")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    body = placed(load_user_mesh(options.objects / options.name / "model.obj"))
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        capture = work / f"{options.name}-flat"
        if not capture.exists():
            write_still_capture(capture, body, VIEWS, size=SIZE, lighting=FLAT)
        held = [f"{VIEWS[1].name}{k}" for k in range(VIEWS[1].count)]
        config = load_reconstruction_config(overrides=options.settings)
        field = reconstruct(capture, out=work / f"{options.name}-flat-result", config=config, held_out=held).field
    mesh, positions = drop(body, options.nodes)
    rows, pictures = compare(body, field, mesh, positions)
    worst = int(np.argmax([row.deformation for row in rows]))
    bound_error = float(non_affinity_at(field, mesh, positions[worst]))
    settings = f" --set {' '.join(options.settings)}" if options.settings else ""
    command = f"python benchmarks/moving_field.py --objects gso --name {options.name} --nodes {options.nodes}{settings}"
    content = {
        "command": command,
        "convexes": len(field),
        "nodes": len(mesh.vertices),
        "frame_of_largest_deformation": worst,
        "psnr_at_rest": rows[0].field,
        "psnr_at_largest_deformation": rows[worst].field,
        "largest_non_affinity_of_a_convex_99_percent": bound_error,
        "frames": [asdict(row) for row in rows],
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps({name: value for name, value in content.items() if name != "frames"}, indent=1))
    shown = [0, worst // 2, worst, FRAMES - 1]
    Image.fromarray(np.concatenate([pictures[k] for k in shown], axis=1)).save(PICTURE)


def compare(
    body: ObjectMesh, field: ConvexField, mesh: TetMesh, positions: np.ndarray
) -> tuple[list[Frame], list[np.ndarray]]:
    """Scores of every frame, and columns of pictures: body, field, four times the difference."""
    surface = Embedding.of_points(mesh, body.vertices).apply(positions)
    (camera,) = still_cameras(surface.reshape(-1, 3), StillViews(1, (12.0,), phase=0.13), SIZE)
    colours = Surface(body.vertices, body.faces, colors=body.vertex_colors, uv=body.uv, texture=body.texture)
    observed = rendered_frames(colours, camera, FLAT, surface)
    bound, rows, pictures = bind_to_tets(field, mesh), [], []
    for places, rgba, amount in zip(positions, observed, deformations(surface), strict=True):
        values = torch.as_tensor(rgba.astype(np.float32) / 255)
        alpha = values[..., 3:]
        reference, moved = alpha * values[..., :3] + 1 - alpha, bound.at(places)
        image = drawn(moved, camera)
        shifted, turned = (drawn(rigid(bound, moved, places, turned=turn), camera) for turn in (False, True))
        inside = alpha[..., 0] > 0
        rows.append(
            Frame(
                float(amount),
                psnr(image, reference),
                psnr(image[inside], reference[inside]),
                float(structural_similarity(image, reference)),
                psnr(shifted, reference),
                psnr(turned, reference),
            )
        )
        column = torch.cat([reference, image, (4 * (image - reference).abs()).clamp(0, 1)])
        pictures.append((255 * column.numpy()).round().astype(np.uint8))
        print(rows[-1], flush=True)
    return rows, pictures


def non_affinity_at(field: ConvexField, mesh: TetMesh, positions: np.ndarray) -> float:
    """99 % of the convexes are deformed more nearly affinely than this."""

    def deform(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        moved = Embedding.of_points(mesh, points.double().numpy()).apply(positions)
        return torch.as_tensor(moved).to(points), torch.eye(3).expand(len(points), 3, 3)

    chosen = torch.arange(0, len(field), max(1, len(field) // 2000))
    return float(non_affinity(field.select(chosen).to(torch.float64), deform).quantile(0.99))


if __name__ == "__main__":
    main()
