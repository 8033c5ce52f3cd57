"""Convexes and 3D Gaussians with as many numbers, fitted to the same views through the same loop.

Views as in `reconstruction.py`, smaller so that both are quick. All convexes are drawn here (none kept for the inside),
69 numbers each; Gaussians have 59, so there are 69/59 as many. Rates of both were chosen by a few trials on the first
object at 96² (`--tune` is one for the Gaussians).

python benchmarks/gaussian_comparison.py --objects data/gso [--names Dino_4 …] [--size 160] [--set steps=120]
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from gaussian_fit import Rates, fit_gaussians, score_gaussians
from reconstruction import VIEWS, stored_rows

from data_gen import load_user_mesh, write_still_capture
from inference import CaptureViews, capture_views
from physconvex.io import load_capture
from physconvex.reconstruction import begin, fit_field, load_reconstruction_config, score_views, start_field

RESULT = Path(__file__).parent / "results" / "gaussian_comparison.json"
SETTINGS = ("steps=120", "budget=3500", "filler_share=0", "gap_share=0")
NAMES = [
    "Schleich_Lion_Action_Figure", "Dino_4", "BUNNY_RACER", "Room_Essentials_Mug_White_Yellow",
    "Kong_Puppy_Teething_Rubber_Small_Pink", "Schleich_Hereford_Bull",
]  # fmt: skip
NUMBERS = {"convexes": 69, "gaussians": 59}


@dataclass(frozen=True)
class Row:
    """One object and one kind of primitive: PSNR [dB] and SSIM, means over views; processor time of the fit."""

    object: str
    kind: str
    count: int
    numbers: int
    training_psnr: float
    held_out_psnr: float
    held_out_ssim: float
    processor_seconds: float


def captured(name: str, options: argparse.Namespace, work: Path) -> tuple[CaptureViews, Path]:
    """Views of an object, rendered once."""
    folder = work / f"{name}-{options.size}"
    if not folder.exists():
        write_still_capture(folder, load_user_mesh(options.objects / name / "model.obj"), VIEWS, size=options.size)
    return capture_views(load_capture(folder), [f"{VIEWS[1].name}{k}" for k in range(VIEWS[1].count)]), folder


def convexes(name: str, views: CaptureViews, folder: Path, settings: list[str]) -> Row:
    """Fit and score convexes."""
    config = load_reconstruction_config(overrides=[*SETTINGS, *settings])
    clock = time.process_time()
    state = fit_field(
        begin(start_field(views.training, config, mesh=load_capture(folder).mesh())), views.training, config
    )
    spent, field = time.process_time() - clock, state.field()
    trained, held = ([one for one, _ in score_views(field, part)] for part in (views.training, views.held_out))
    return Row(
        name, "convexes", len(field), len(field) * NUMBERS["convexes"], float(np.mean([one.psnr for one in trained])),
        float(np.mean([one.psnr for one in held])), float(np.mean([one.ssim for one in held])), spent,
    )  # fmt: skip


def gaussians(name: str, views: CaptureViews, folder: Path, settings: list[str], rates: Rates) -> Row:
    """Fit and score Gaussians with as many numbers."""
    config = load_reconstruction_config(overrides=[*SETTINGS, *settings])
    budget = config.budget * NUMBERS["convexes"] // NUMBERS["gaussians"]
    config = config.model_copy(update={"budget": budget})
    mesh = load_capture(folder).mesh()
    assert mesh is not None
    clock = time.process_time()
    scene = fit_gaussians(views.training, config, mesh=mesh, rates=rates)
    spent = time.process_time() - clock
    trained, held = score_gaussians(scene, views.training), score_gaussians(scene, views.held_out)
    return Row(
        name, "gaussians", len(scene), len(scene) * NUMBERS["gaussians"], trained.psnr, held.psnr, held.ssim, spent
    )


def main() -> None:
    """Compare and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True, help="folder of folders with model.obj and texture.png")
    parser.add_argument("--names", nargs="+", default=NAMES)
    parser.add_argument("--size", type=int, default=160)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--set", dest="settings", nargs="*", default=[], help="settings, as steps=120")
    parser.add_argument(
        "--tune", action="store_true", help="try rates of the Gaussians on the first object, store none"
    )
    parser.add_argument("--work", type=Path, help="folder for captures; kept if given")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in options.names[:1] if options.tune else options.names:
            views, folder = captured(name, options, options.work or Path(scratch))
            if options.tune:
                for centre, scale, opacity in itertools.product((0.2, 0.4), (0.03, 0.08), (0.05, 0.15)):
                    rates = Rates(centre=centre, scale=scale, opacity=opacity)
                    print(rates, gaussians(name, views, folder, options.settings, rates), flush=True)
                continue
            rows.append(convexes(name, views, folder, options.settings))
            print(rows[-1], flush=True)
            rows.append(gaussians(name, views, folder, options.settings, Rates()))
            print(rows[-1], flush=True)
            command = f"python benchmarks/gaussian_comparison.py --objects gso --size {options.size}"
            command += f" --set {' '.join(options.settings)}" if options.settings else ""
            kept = stored_rows(RESULT, command, options.names)
            content = {"command": command, "rows": [*kept, *(asdict(row) for row in rows)]}
            RESULT.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
