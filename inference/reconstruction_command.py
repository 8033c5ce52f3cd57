"""The command `physconvex reconstruct`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inference.settings import ReconstructOptions
from physconvex.io import command

if TYPE_CHECKING:
    from inference.reconstruction import Reconstruction


@command
def reconstruct_command(
    *,
    capture: Annotated[Path, typer.Argument(help="Capture folder with several cameras.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("reconstruction"),
    options: ReconstructOptions,
    turntable: Annotated[bool, typer.Option(help="Write a turntable film.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the summary, as JSON.")] = False,
    redo: Annotated[bool, typer.Option("--redo", help="Start from scratch; ignore results in the folder.")] = False,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="Hide the progress bar.")] = False,
) -> None:
    """Reconstruct the object in the first frames of several cameras as a convex field and a closed surface.

    Writes field.ply, hulls.glb, body.ply, body.glb, reconstruction.json, comparison images and a film. It can be
    stopped at any time; the same command resumes.
    """
    from tqdm import tqdm

    from inference.reconstruction import reconstruct
    from physconvex.reconstruction import FitProgress

    shown = not no_progress and sys.stderr.isatty()
    with tqdm(total=options.resolved.steps, unit="step", disable=not shown, file=sys.stderr, dynamic_ncols=True) as bar:

        def advance(progress: FitProgress) -> None:
            if bar.n == 0:
                bar.initial = progress.step - 1
            bar.set_postfix(loss=f"{progress.loss:.4f}", convexes=progress.convexes, scale=f"{progress.scale:g}")
            bar.update(progress.step - bar.n)

        result = reconstruct(capture, out=out, options=options, turntable=turntable, redo=redo, on_step=advance)
    if as_json:
        print(json.dumps(result.to_json()))
    else:
        _print(result, out)


def _print(result: Reconstruction, out: Path) -> None:
    record = result.to_json()
    print(f"{out}: {len(result.field)} convexes from the {result.start}, {result.seconds:.0f} s")
    if record["body"] is not None:
        print(f"  body: {1e6 * record['body']['volume']:.4g} cm³, {1e3 * record['body']['size']:.4g} mm long")
    for name, scores in (("training", record["training"]), ("held out", record["held_out"])):
        if scores["views"]:
            text = "PSNR {psnr:.2f} dB ({psnr_object:.2f} on the object), SSIM {ssim:.4f}".format(**scores["mean"])
            print(f"  {name} ({len(scores['views'])} views): {text}")
