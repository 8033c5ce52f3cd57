"""Convexes split where a simulated motion is not affine within them, merged again, and simplified, on a real field.

A scanned object is reconstructed with few, large convexes from views in flat light, and dropped as a soft body, as in
`moving_field.py`. For its most deformed frame the field is split until the deformation is affine within each convex up
to the tolerance, without and with an overlap of the parts; then neighbours are merged again at rest until no more may
be. Beside it, the field simplified to half its convexes by the views. Each state is compared with the field as it was
reconstructed (at rest: occupancy at random points of its box, share of them within a hull, the picture) and with the
textured body (at rest and in the most deformed frame). What is less than a quarter of a pixel's footprint off affine is
not split: the map of finite elements is bent at their faces.

python benchmarks/convex_dynamics.py --objects data/gso [--names Dino_4 …] [--budget 1500] [--tolerance 0.02] [--work W]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from moving_field import SIZE, VIEWS, deformations, drawn, drop, placed

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
from physconvex.convex import (
    ConvexField,
    DeformationMap,
    advect,
    inside_union,
    merge,
    non_affinity,
    occupancies,
    split_until_affine,
    tet_map,
)
from physconvex.io import Camera, load_capture
from physconvex.mesh import Embedding
from physconvex.reconstruction import psnr, simplify

RESULT = Path(__file__).parent / "results" / "convex_dynamics.json"
PROBES = 20_000
OVERLAP = 2.0  # widths of an edge
LEAST = 0.25  # pixels
HALF = 0.5  # of the convexes is left by `simplify`


@dataclass(frozen=True)
class Row:
    """One state of one object's field.

    Attributes:
        convexes: how many.
        non_affinity: 99 % of the convexes are deformed more nearly affinely than this, as a share of their size.
        off_affine: the same in pixels of the camera at the body.
        lost_volume: of the hulls' volume before, that no hull holds after.
        occupancy: mean over the probes of 1 − Π (1 − opacity O).
        occupancy_change: mean of the magnitude of its difference from the reconstructed field's.
        membership_change: share of the probes that are in a hull of one of the two fields only.
        same_picture: PSNR at rest against the picture of the reconstructed field [dB]; None for that itself.
        at_rest, deformed: PSNR against the textured body [dB].
    """

    object: str
    state: str
    convexes: int
    non_affinity: float
    off_affine: float
    lost_volume: float
    occupancy: float
    occupancy_change: float
    membership_change: float
    same_picture: float | None
    at_rest: float
    deformed: float


@dataclass(frozen=True, eq=False)
class Motion:
    """The most deformed frame: its map, the camera, pictures of the textured body at rest and then, deformation; what
    a pixel covers at the body [m]."""

    deform: DeformationMap
    camera: Camera
    pictures: tuple[torch.Tensor, torch.Tensor]
    deformation: float
    pixel: float


def motion_of(body: ObjectMesh, nodes: int) -> Motion:
    """Drop the body and look at it."""
    mesh, positions = drop(body, nodes)
    surface = Embedding.of_points(mesh, body.vertices).apply(positions)
    amounts = deformations(surface)
    worst = int(amounts.argmax())
    (camera,) = still_cameras(surface.reshape(-1, 3), StillViews(1, (12.0,), phase=0.13), SIZE)
    distance = float(np.linalg.norm(np.asarray(camera.position) - surface[worst].mean(axis=0)))
    pixel = distance / camera.fl_y
    seen = []
    for rgba in rendered_frames(body.drawn(), camera, FLAT, surface[[0, worst]]):
        values = torch.as_tensor(rgba.astype(np.float32) / 255)
        seen.append(values[..., 3:] * values[..., :3] + 1 - values[..., 3:])
    return Motion(tet_map(mesh, positions[worst]), camera, (seen[0], seen[1]), float(amounts[worst]), pixel)


def states(field: ConvexField, motion: Motion, tolerance: float) -> Iterator[tuple[str, ConvexField, float]]:
    """Names, fields in float64 and volumes [m³] that were lost."""
    yield "as reconstructed", field, 0.0
    divided = field
    for name, overlap in (("split", 0.0), ("split with overlap", OVERLAP)):
        found = split_until_affine(
            field,
            motion.deform,
            tolerance=tolerance,
            limit=20 * len(field),
            least=LEAST * motion.pixel,
            overlap=overlap,
        )
        yield name, found.field, found.lost_volume
        divided = found.field if overlap == 0 else divided
    lost = 0.0
    while True:
        found = merge(divided)
        if len(found.field) == len(divided):
            break
        divided, lost = found.field, lost + found.lost_volume
    yield "split, merged again", divided, lost


def off_affine(field: ConvexField, motion: Motion) -> tuple[float, float]:
    """99 % of the distances from the best affine map, as a share of the size and in pixels."""
    points = motion.deform(field.points.reshape(-1, 3))[0].reshape(field.points.shape)
    sizes = torch.cdist(points, points).flatten(1).amax(dim=1)
    shares = non_affinity(field, motion.deform)
    return float(shares.quantile(0.99)), float((shares * sizes / motion.pixel).quantile(0.99))


def measure(name: str, work: Path, options: argparse.Namespace) -> list[Row]:
    """All states of one object."""
    body = placed(load_user_mesh(options.objects / name / "model.obj"))
    capture = work / f"{name}-flat"
    if not capture.exists():
        write_still_capture(capture, body, VIEWS, size=SIZE, lighting=FLAT)
    held = [f"{VIEWS[-1].name}{k}" for k in range(VIEWS[-1].count)]
    settings = ReconstructOptions(budget=options.budget, held_out=held)
    single = reconstruct(capture, out=work / f"{name}-{options.budget}", options=settings).field
    field, motion = single.to(torch.float64), motion_of(body, options.nodes)
    print(f"{name}: deformed by {motion.deformation:.3f} of its size", flush=True)
    corners = single.points.reshape(-1, 3).double().numpy()
    probes = np.random.default_rng(0).uniform(corners.min(axis=0), corners.max(axis=0), (PROBES, 3))
    volume = float(np.prod(np.ptp(corners, axis=0)))
    views = capture_views(load_capture(capture), held).training
    simplified = simplify(single, views, budget=round(HALF * len(single))).to(torch.float64)
    occupied, within = occupancies(field, probes)[1], inside_union(field, probes)
    first, _ = drawn(single, motion.camera)
    rows = []
    for state, some, lost in (
        *states(field, motion, options.tolerance),
        ("simplified to half", simplified, 0.0),
    ):
        at_rest, _ = drawn(some.to(torch.float32), motion.camera)
        moved, _ = drawn(advect(some, motion.deform).to(torch.float32), motion.camera)
        occupancy, member = occupancies(some, probes)[1], inside_union(some, probes)
        rows.append(
            Row(
                name,
                state,
                len(some),
                *off_affine(some, motion),
                float(lost / (volume * within.mean())),
                float(occupancy.mean()),
                float(np.abs(occupancy - occupied).mean()),
                float((member != within).mean()),
                None if state == "as reconstructed" else psnr(at_rest, first),
                psnr(at_rest, motion.pictures[0]),
                psnr(moved, motion.pictures[1]),
            )
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True, help="folder of folders with model.obj and texture.png")
    parser.add_argument("--names", nargs="+", default=["Schleich_Lion_Action_Figure", "Dino_4"])
    parser.add_argument("--budget", type=int, default=1500)
    parser.add_argument("--tolerance", type=float, default=0.02, help="share of a convex's size")
    parser.add_argument("--nodes", type=int, default=500)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--work", type=Path, help="folder for captures and fields; kept if given")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    command = f"python benchmarks/convex_dynamics.py --objects gso --names {' '.join(options.names)}"
    command += f" --budget {options.budget} --tolerance {options.tolerance:g} --nodes {options.nodes}"
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in options.names:
            rows += measure(name, options.work or Path(scratch), options)
            content = {"command": command, "rows": [asdict(row) for row in rows]}
            RESULT.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
