"""The command `physconvex reconstruct`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from inference.reconstruction import Reconstruction


def reconstruct_command(
    *,
    capture: Annotated[Path, typer.Argument(help="Folder with capture.json and several cameras.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("reconstruction"),
    held_out: Annotated[
        list[str] | None, typer.Option("--held-out", help="Camera that is scored but not fitted; repeatable.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file of settings.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Override, as budget=12000 or point_rate=0.1; repeatable.")
    ] = None,
    start: Annotated[str | None, typer.Option(help="mesh, hull, points or auto (the first there is).")] = None,
    points: Annotated[Path | None, typer.Option(help="File whose vertices the convexes may start from [m].")] = None,
    budget: Annotated[int | None, typer.Option(help="Most convexes. Default: 16000.")] = None,
    steps: Annotated[int | None, typer.Option(help="Steps of the optimiser, one view each. Default: 200.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    turntable: Annotated[bool, typer.Option(help="Write a film of the object from all round.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON, nothing else.")] = False,
    device: Annotated[str, typer.Option(help="Torch device that draws and fits, such as cpu or cuda.")] = "cpu",
    redo: Annotated[bool, typer.Option("--redo", help="Start anew, whatever is in the folder.")] = False,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="No progress bar.")] = False,
) -> None:
    """Reconstruct the object of a multi-view capture, as it is in the first frame, as coloured convexes.

    Writes field.ply, hulls.glb, reconstruction.json, comparison images and a film. Stop it at any time: the same
    command goes on where it stopped.
    """
    from tqdm import tqdm

    from inference.reconstruction import reconstruct as run
    from physconvex.reconstruction import FitProgress, load_reconstruction_config

    resolved = load_reconstruction_config(
        config, overrides=settings or [], start=start, budget=budget, steps=steps, seed=seed
    )
    shown = not no_progress and sys.stderr.isatty()
    with tqdm(total=resolved.steps, unit="step", disable=not shown, file=sys.stderr, dynamic_ncols=True) as bar:

        def advance(progress: FitProgress) -> None:
            if bar.n == 0:
                bar.initial = progress.step - 1
            bar.set_postfix(loss=f"{progress.loss:.4f}", convexes=progress.convexes, scale=f"{progress.scale:g}")
            bar.update(progress.step - bar.n)

        result = run(
            capture,
            out=out,
            config=resolved,
            held_out=held_out or [],
            points=points,
            turntable=turntable,
            redo=redo,
            device=device,
            on_step=advance,
        )
    if as_json:
        print(json.dumps(result.to_json()))
    else:
        _print(result, out)


def _print(result: Reconstruction, out: Path) -> None:
    rows = {"training": result.training, "held out": result.held_out}
    print(f"{out}: {len(result.field)} convexes from the {result.start}, {result.seconds:.0f} s")
    for name, scores in rows.items():
        if scores:
            count = len(scores)
            psnr, inside, ssim = (sum(getattr(s, of) for s in scores) / count for of in ("psnr", "psnr_object", "ssim"))
            print(f"  {name} ({count} views): PSNR {psnr:.2f} dB ({inside:.2f} on the object), SSIM {ssim:.4f}")
