"""The command `physconvex evaluate paper`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["paper"]


def paper(
    benchmark: Annotated[Path, typer.Argument(help="Folder of `physconvex generate benchmark`.")],
    out: Annotated[Path, typer.Option(help="Folder of the results; finished parts are kept.")] = Path("paper"),
    name: Annotated[list[str] | None, typer.Option(help="Work on this object; repeatable. Default: all.")] = None,
    comparisons: Annotated[
        bool, typer.Option(help="Also the published way and the parts over M and K, which come last.")
    ] = True,
    max_nodes: Annotated[int, typer.Option(help="Most nodes of the models' meshes.")] = 500,
    fine_nodes: Annotated[
        int | None, typer.Option(help="Most nodes of the mesh of refine's last searches; default: as it has them.")
    ] = None,
    steps_per_frame: Annotated[int | None, typer.Option(help="Of the models. Default: 384 per second.")] = None,
    weights: Annotated[int, typer.Option(help="Skinning weights of `refine`.")] = 20,
    full_runs: Annotated[int, typer.Option(help="Most linearisations of the full model.")] = 8,
    model_error: Annotated[bool, typer.Option(help="Add what a finer mesh says.")] = True,
    adam_steps: Annotated[int, typer.Option(help="Of the published way; 0 leaves it out.")] = 400,
    ablation: Annotated[list[int] | None, typer.Option(help="Weights of the reduced model alone; repeatable.")] = None,
    points: Annotated[
        list[int] | None, typer.Option(help="Points per convex of further fields; repeatable; 0: none.")
    ] = None,
    field_budget: Annotated[int, typer.Option(help="Most convexes of a field.")] = 24_000,
    field_steps: Annotated[int, typer.Option(help="Steps of a field's fit.")] = 400,
    checkpoint: Annotated[str, typer.Option(help="Name or folder of the network's checkpoint.")] = "default",
    no_progress: Annotated[bool, typer.Option("--no-progress", help="Say nothing while it runs.")] = False,
) -> None:
    """Identification, dynamic reconstruction, future prediction, generalisation and ablation over a benchmark.

    Beside a constant guess, the network alone, and the published way of fitting, run here. Writes tables.md,
    paper.json and objects/NAME.json. Stop it at any time: the same command goes on after the last finished part, with
    the objects whose truth is there by then.
    """
    from train.paper.evaluation import PaperOptions, evaluate_paper
    from train.paper.tables import markdown, summary

    options = PaperOptions(
        max_nodes=max_nodes,
        fine_nodes=fine_nodes,
        steps_per_frame=steps_per_frame,
        weights=weights,
        full_runs=full_runs,
        model_error=model_error,
        adam_steps=adam_steps,
        ablation=tuple(ablation) if ablation else PaperOptions().ablation,
        ablation_points=tuple(k for k in points if k) if points else PaperOptions().ablation_points,
        field_budget=field_budget,
        field_steps=field_steps,
        checkpoint=checkpoint,
    )

    def say(name: str, part: str) -> None:
        if not no_progress:
            print(f"physconvex evaluate paper: {name}: {part} …", file=sys.stderr, flush=True)

    rows = evaluate_paper(benchmark, out, options, names=name, comparisons=comparisons, on_part=say)
    made = json.loads((benchmark / "benchmark.json").read_text(encoding="utf-8"))["options"]
    note = (
        f"{len(rows)} of {made['count']} objects, {made['size']}² pixels, {made['views']} views, "
        f"{made['observed_frames']} of {made['frames']} frames observed from the front; truth of at most "
        f"{made['nodes']} nodes and {made['steps_per_frame']} steps per frame."
    )
    content = {"benchmark": made, "summary": summary(rows), "objects": rows}
    (out / "paper.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (out / "tables.md").write_text(markdown(rows, note), encoding="utf-8")
    typer.echo((out / "tables.md").read_text(encoding="utf-8"))
