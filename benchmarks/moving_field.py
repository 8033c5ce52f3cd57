"""A reconstructed field that moves with a simulated body, against the textured body rendered in every frame.

A scanned object in flat light (its colours do not depend on how it turns) is reconstructed from 12 views as in
`reconstruction.py` and 12 more from above and below, so that what the motion brings to light was seen; then dropped as
a soft body (quadratic tetrahedra, 24 frames) and seen by a camera of its own. The tetrahedra fill a cage about the
object (its surface moved outward by a few per cent of its size), so that every point of the textured surface and of the
field lies in an element, and both are carried by one continuous map. Beside it, the same convexes moved with their
centres alone (shifted; shifted and turned by the polar rotation), and Gaussians with as many numbers, fitted to the
same views through the same loop: moved by their centres, and with their covariances, F Σ Fᵀ. Results of other objects
from runs with the same settings are kept.

python benchmarks/moving_field.py --objects data/gso [--names Dino_4 …] [--nodes 500] [--set steps=120 budget=12000]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from gaussian_fit import fit_gaussians, score_gaussians
from gaussians import Gaussians, quaternions_of, render_gaussians, rotation_matrices
from PIL import Image
from scipy.ndimage import binary_erosion

from data_gen import (
    FLAT,
    ObjectMesh,
    StillViews,
    load_user_mesh,
    rendered_frames,
    still_cameras,
    write_still_capture,
)
from inference import ReconstructOptions, capture_views, reconstruct
from physconvex.convex import BoundField, ConvexField, bind_to_tets, non_affinity, polar_rotation
from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.io import Camera, load_capture
from physconvex.mesh import Embedding, TetMesh, locate, surface_distance, tetrahedralize_implicit
from physconvex.reconstruction import (
    ReconstructionConfig,
    load_reconstruction_config,
    psnr,
    structural_similarity,
    welded,
)
from physconvex.render import View, render

RESULT = Path(__file__).parent / "results" / "moving_field.json"
PICTURES = Path(__file__).parents[1] / "docs" / "images"
FRAMES, RATE, SIZE = 24, 60.0, 448
STIFFNESS = 6.0  # E in units of density · gravity · size
DENSITY, RATIO, GRAVITY = 1000.0, 0.4, 9.81
HEIGHT = 0.4  # of the drop, in sizes
VIEWS = (
    StillViews(12, (10, 35, -10), name="fit"),
    StillViews(6, (-50,), phase=0.5, name="below"),
    StillViews(6, (65,), phase=0.25, name="above"),
    StillViews(4, (20, 0), phase=0.37, name="held"),
)
CAGES = (0.05, 0.07, 0.09)  # by how much the cage is larger, in sizes; the first that holds all is taken
NUMBERS = 69, 59  # of a convex, of a Gaussian


@dataclass(frozen=True)
class Frame:
    """One frame: PSNR [dB] over the whole image of the field, of the two rigid ways, of the Gaussians moved by their
    centres, and with their covariances; SSIM and PSNR on the object of the field; `holes` is the share of the body's
    pixels, its rim left out, through which more than a tenth of the background is seen, in the field and in the
    Gaussians moved by their centres; `deformation` is the rms distance of the surface from its best rigid fit to rest,
    over the size."""

    deformation: float
    field: float
    field_object: float
    field_ssim: float
    shifted: float
    shifted_and_turned: float
    gaussians_by_centres: float
    gaussians_with_covariances: float
    holes: float
    holes_of_gaussians: float


def placed(body: ObjectMesh) -> ObjectMesh:
    """The object with its lowest point at the height of the drop, over the origin."""
    low, high = body.bounds
    size = float((high - low).max())
    shift = np.array([-0.5 * (low + high)[0], -0.5 * (low + high)[1], HEIGHT * size - low[2]])
    return replace(body, vertices=body.vertices + shift)


def cage(body: ObjectMesh, nodes: int) -> TetMesh:
    """Tetrahedra that hold the whole surface."""
    surface = welded(trimesh.Trimesh(body.vertices, body.faces, process=False))
    distance = surface_distance(surface.vertices, surface.faces)
    size = float(np.ptp(body.vertices, axis=0).max())
    for share in CAGES:
        margin = share * size
        bounds = surface.bounds + np.array([[-margin], [margin]])
        mesh = tetrahedralize_implicit(lambda p, margin=margin: distance(p) - margin, bounds, max_nodes=nodes, order=2)
        if not locate(mesh, body.vertices)[3].any():
            break
    return mesh


def drop(body: ObjectMesh, nodes: int) -> tuple[TetMesh, np.ndarray]:
    """Rest mesh and nodal positions [T, V, 3] of the fall and bounce."""
    mesh = cage(body, nodes)
    size = float(np.ptp(body.vertices, axis=0).max())
    modulus = STIFFNESS * DENSITY * GRAVITY * size
    elastic = ElasticBody(mesh, youngs_modulus=modulus, poisson_ratio=RATIO, density=DENSITY)
    scene = Scene(body=elastic, obstacles=(Plane(friction=0.5),), gravity=(0.0, 0.0, -GRAVITY), damping_time=5e-4)
    return mesh, simulate(scene, Timing(frames=FRAMES, fps=RATE, steps_per_frame=8)).positions


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


def drawn(field: ConvexField, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """The image before white, and alpha."""
    with torch.no_grad():
        image = render(field, camera)
    return image.colour.clamp(0, 1), image.alpha


def markers(scene: Gaussians) -> ConvexField:
    """A field whose centres and harmonics are those of the Gaussians, to be bound like any other."""
    ones = torch.ones(len(scene))
    points = scene.centres[:, None].expand(-1, 4, -1).contiguous()
    return ConvexField(points, ones, ones, ones, scene.harmonics)


def moved_gaussians(scene: Gaussians, bound: BoundField, positions: np.ndarray, *, whole: bool) -> Gaussians:
    """At the moved centres; with the covariances F Σ Fᵀ and turned colours if `whole`, else as they were at rest."""
    moved = bound.at(positions)
    if not whole:
        return replace(scene, centres=moved.centres)
    gradients = torch.as_tensor(np.asarray(bound.gradients @ positions).reshape(-1, 3, 3).swapaxes(1, 2)).float()
    stretched = gradients @ (rotation_matrices(scene.quaternions) * scene.log_scales.exp()[:, None])
    axes, scales, _ = torch.linalg.svd(stretched)
    axes = axes * torch.det(axes)[:, None, None]
    return replace(
        scene,
        centres=moved.centres,
        log_scales=scales.clamp(min=1e-9).log(),
        quaternions=quaternions_of(axes),
        harmonics=moved.harmonics,
    )


def fitted(
    body: ObjectMesh, name: str, work: Path, config: ReconstructionConfig
) -> tuple[ConvexField, Gaussians, dict]:
    """The field, Gaussians with as many numbers, and the scores of both in views that were not fitted."""
    capture = work / f"{name}-flat"
    if not capture.exists():
        write_still_capture(capture, body, VIEWS, size=SIZE, lighting=FLAT)
    held = [f"{VIEWS[-1].name}{k}" for k in range(VIEWS[-1].count)]
    options = ReconstructOptions(config=config, held_out=held)
    result = reconstruct(capture, out=work / f"{name}-flat-result", options=options)
    source = load_capture(capture)
    views, mesh = capture_views(source, held), source.mesh()
    assert mesh is not None
    count = NUMBERS[0] * len(result.field) // NUMBERS[1]
    kept = work / f"{name}-gaussians.npz"
    if kept.exists():
        with np.load(kept) as stored:
            gaussians = Gaussians(*(torch.as_tensor(stored[entry]) for entry in stored.files))
    else:
        gaussians = fit_gaussians(views.training, config.model_copy(update={"budget": count}), mesh=mesh)
        np.savez(kept, *(tensor.numpy() for tensor in gaussians.tensors()))
    scores = {
        "convexes": len(result.field),
        "gaussians": len(gaussians),
        "held_out_psnr": float(np.mean([one.psnr for one in result.held_out])),
        "held_out_psnr_of_gaussians": score_gaussians(gaussians, views.held_out).psnr,
    }
    return result.field, gaussians, scores


def main() -> None:
    """Reconstruct, simulate, compare, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True, help="folder of folders with model.obj and texture.png")
    parser.add_argument("--names", nargs="+", default=["Schleich_Lion_Action_Figure"])
    parser.add_argument("--nodes", type=int, default=500)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--set", dest="settings", nargs="*", default=[], help="settings, as steps=120")
    parser.add_argument("--work", type=Path, help="folder for captures and fields; kept if given")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    settings = f" --set {' '.join(options.settings)}" if options.settings else ""
    command = f"python benchmarks/moving_field.py --objects gso --nodes {options.nodes}{settings}"
    found = stored_objects(command)
    with tempfile.TemporaryDirectory() as scratch:
        for name in options.names:
            config = load_reconstruction_config(overrides=options.settings)
            content, pictures = measure(name, options.work or Path(scratch), config, options)
            found[name] = content
            print(json.dumps({entry: value for entry, value in content.items() if entry != "frames"}, indent=1))
            RESULT.write_text(json.dumps({"command": command, "objects": found}, indent=1) + "\n")
            worst = content["frame_of_largest_deformation"]
            shown = [pictures[k] for k in (0, worst // 2, worst, FRAMES - 1)]
            Image.fromarray(np.concatenate(shown, axis=1)).save(PICTURES / f"moving_field_{name}.jpg", quality=90)


def stored_objects(command: str) -> dict[str, Any]:
    """Results that the same command (but for the names) has stored."""
    content = json.loads(RESULT.read_text()) if RESULT.exists() else {"command": None}
    return content["objects"] if content["command"] == command else {}


def measure(
    name: str, work: Path, config: ReconstructionConfig, options: argparse.Namespace
) -> tuple[dict, list[np.ndarray]]:
    """One object."""
    body = placed(load_user_mesh(options.objects / name / "model.obj"))
    field, gaussians, scores = fitted(body, name, work, config)
    mesh, positions = drop(body, options.nodes)
    rows, pictures = compare(body, field, gaussians, mesh, positions)
    worst = int(np.argmax([row.deformation for row in rows]))
    kinds = ("field", "shifted", "shifted_and_turned", "gaussians_by_centres", "gaussians_with_covariances")
    content = {
        **scores,
        "nodes": len(mesh.vertices),
        "frame_of_largest_deformation": worst,
        "psnr_at_rest": {kind: getattr(rows[0], kind) for kind in kinds},
        "loss_by_the_largest_deformation": {
            kind: getattr(rows[0], kind) - getattr(rows[worst], kind) for kind in kinds
        },
        "non_affinity_of_convexes_99_percent": non_affinity_at(field, mesh, positions[worst]),
        "frames": [asdict(row) for row in rows],
    }
    return content, pictures


def compare(
    body: ObjectMesh, field: ConvexField, gaussians: Gaussians, mesh: TetMesh, positions: np.ndarray
) -> tuple[list[Frame], list[np.ndarray]]:
    """Scores of every frame, and columns of pictures: body, field, Gaussians by their centres, four times the
    difference of the field."""
    surface = Embedding.of_points(mesh, body.vertices).apply(positions)
    (camera,) = still_cameras(surface.reshape(-1, 3), StillViews(1, (12.0,), phase=0.13), SIZE)
    observed = rendered_frames(body.drawn(), camera, FLAT, surface)
    bound, marked = bind_to_tets(field, mesh), bind_to_tets(markers(gaussians), mesh)
    rows, pictures, view = [], [], View.of(camera)
    for places, rgba, amount in zip(positions, observed, deformations(surface), strict=True):
        values = torch.as_tensor(rgba.astype(np.float32) / 255)
        alpha = values[..., 3:]
        reference, moved = alpha * values[..., :3] + 1 - alpha, bound.at(places)
        image, opaque = drawn(moved, camera)
        shifted, turned = (drawn(rigid(bound, moved, places, turned=turn), camera)[0] for turn in (False, True))
        blobs = [
            render_gaussians(moved_gaussians(gaussians, marked, places, whole=whole), view) for whole in (False, True)
        ]
        inside, core = alpha[..., 0] > 0, torch.as_tensor(binary_erosion(alpha[..., 0].numpy() > 0.99, iterations=2))
        rows.append(
            Frame(
                float(amount),
                psnr(image, reference),
                psnr(image[inside], reference[inside]),
                float(structural_similarity(image, reference)),
                psnr(shifted, reference),
                psnr(turned, reference),
                *(psnr(blob.colour.clamp(0, 1), reference) for blob in blobs),
                *(float((one[core] < 0.9).float().mean()) for one in (opaque, blobs[0].alpha)),
            )
        )
        difference = (4 * (image - reference).abs()).clamp(0, 1)
        column = torch.cat([reference, image, blobs[0].colour.clamp(0, 1), difference])
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
