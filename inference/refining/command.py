"""The command `physconvex refine`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from physconvex.errors import InputError

__all__ = ["refine"]

_STAGES = {
    "points": "following points in the videos",
    "scan": "scanning Young's modulus",
    "reduced": "fitting the reduced model",
    "coarse": "fitting the full model on few nodes",
    "frame_errors": "comparing few nodes with more",
    "anchored": "following the points again from the model",
    "reduced_again": "fitting the reduced model again",
    "correction": "correcting with the full model",
    "colours": "comparing colours",
    "field": "fitting a convex field to the first images",
    "model_error": "finer model, for the error that is left",
    "motion": "predicting all frames",
}


def refine(
    capture: Annotated[Path, typer.Argument(help="Capture folder with capture.json, rest geometry, tracks or videos.")],
    out: Annotated[Path, typer.Option(help="Folder of the results; finished stages are read again from it.")] = Path(
        "refinement"
    ),
    observations: Annotated[str, typer.Option(help="auto, tracks, video or both.")] = "auto",
    camera: Annotated[list[str] | None, typer.Option(help="Use this camera alone; repeatable. Default: all.")] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(help="Free a parameter, as friction, air_drag, initial_velocity_z; repeatable."),
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(help="Hold a parameter: NAME, or NAME=VALUE, as damping_time=0; repeatable."),
    ] = None,
    prior: Annotated[
        list[str] | None, typer.Option(help="Gaussian prior NAME=MEAN,SIGMA, as poisson_ratio=0.49,0.005; repeatable.")
    ] = None,
    initial: Annotated[
        list[str] | None,
        typer.Option(help="Start at NAME=VALUE, as log10_youngs_modulus=5.2, and do not scan; repeatable."),
    ] = None,
    start: Annotated[str, typer.Option(help="Where the scan looks: predict (network), scan (everywhere), auto.")] = (
        "auto"
    ),
    weights: Annotated[int, typer.Option(help="Number of skinning weights.")] = 20,
    max_nodes: Annotated[int, typer.Option(help="Most nodes of the quadratic mesh.")] = 500,
    steps_per_frame: Annotated[int | None, typer.Option(help="Time steps per frame. Default: 384 per second.")] = None,
    full_runs: Annotated[int, typer.Option(help="Most linearisations of the full model in the correction.")] = 8,
    jacobian: Annotated[
        str, typer.Option(help="Derivatives of the correction: of the full or reduced model.")
    ] = "full",
    correction: Annotated[bool, typer.Option(help="Remove the reduced model's error with the full model.")] = True,
    model_error: Annotated[bool, typer.Option(help="State the error that a finer model would remove.")] = True,
    outlines: Annotated[bool, typer.Option(help="Use the masks of videos.")] = True,
    colours: Annotated[bool, typer.Option(help="Last, compare colours instead of points followed in videos.")] = True,
    exposure: Annotated[bool, typer.Option(help="Gain and offset of each frame's colours are free.")] = True,
    camera_rotation: Annotated[
        float, typer.Option(help="Free each camera's rotation, with this prior standard deviation [rad].")
    ] = 0.0,
    camera_position: Annotated[
        float, typer.Option(help="Free each camera's position, with this prior standard deviation [m].")
    ] = 0.0,
    time_offset: Annotated[
        float, typer.Option(help="Free the time of all frames after the first, with this prior deviation [s].")
    ] = 0.0,
    field: Annotated[bool, typer.Option(help="Fit a convex field to the first images and bind it to the body.")] = True,
    field_file: Annotated[str | None, typer.Option(help="A field (PLY) of the body at rest, in place of that.")] = None,
    field_steps: Annotated[int, typer.Option(help="Steps of the field's fit.")] = 150,
    pictures: Annotated[bool, typer.Option(help="Write fit.png and side_by_side.mp4.")] = True,
    checkpoint: Annotated[str, typer.Option(help="Name or folder of the network's checkpoint.")] = "default",
    as_json: Annotated[bool, typer.Option("--json", help="Print refinement.json to standard output, alone.")] = False,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="Say nothing while it runs.")] = False,
) -> None:
    """Identify E, ν and what else is unknown of a capture with the differentiable simulator, and predict its future.

    Writes refinement.json, trajectory.npz, fit.png, side_by_side.mp4 and run.json. Stop it at any time: the same
    command goes on after the last finished stage.
    """
    from inference.refining.options import RefineOptions
    from inference.refining.pipeline import refine as run_refine
    from inference.refining.writing import write_refinement
    from physconvex.identify.nuisance import Nuisance

    options = RefineOptions(
        observations=observations,  # type: ignore[arg-type]
        cameras=tuple(camera) if camera else None,
        weights=weights,
        max_nodes=max_nodes,
        steps_per_frame=steps_per_frame,
        free=tuple(free or ()),
        fixed=dict(_assignment(text) for text in fix or ()),
        priors=dict(_prior(text) for text in prior or ()),
        initial=dict(_value(text) for text in initial or ()),
        start=start,  # type: ignore[arg-type]
        correction=correction,
        full_runs=full_runs,
        jacobian=jacobian,  # type: ignore[arg-type]
        model_error=model_error,
        outlines=outlines,
        colours=colours,
        exposure=exposure,
        field=field,
        field_file=field_file,
        field_steps=field_steps,
        nuisance=Nuisance(camera_rotation, camera_position, time_offset),
        checkpoint=checkpoint,
    )

    def say(stage: str, stored: bool) -> None:
        if not no_progress:
            note = " (read again)" if stored else " …"
            print(f"physconvex refine: {_STAGES.get(stage, stage)}{note}", file=sys.stderr, flush=True)

    found = run_refine(capture, out=out, options=options, on_stage=say)
    write_refinement(found, out, options=options, pictures=pictures)
    if as_json:
        typer.echo(json.dumps(found.to_json(), ensure_ascii=False, allow_nan=False))
    else:
        _print(found, out)


def _assignment(text: str) -> tuple[str, float | None]:
    name, given, value = text.partition("=")
    return name, (_number(text, value, "NAME=VALUE") if given else None)


def _value(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    return name, _number(text, value, "NAME=VALUE")


def _prior(text: str) -> tuple[str, tuple[float, float]]:
    name, _, values = text.partition("=")
    parts: Sequence[str] = values.split(",")
    if len(parts) != 2:
        raise InputError(f"prior: got {text!r}; expected NAME=MEAN,SIGMA")
    return name, (_number(text, parts[0], "NAME=MEAN,SIGMA"), _number(text, parts[1], "NAME=MEAN,SIGMA"))


def _number(text: str, value: str, form: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"got {text!r}; expected {form} with numbers") from None


def _print(found: Any, out: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from inference.refining.result import unit_of

    console, table = Console(), Table()
    for column in ("parameter", "value", "90 % interval", "noise σ", "model error"):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    for e in found.estimates:
        interval = "at its bound" if e.interval is None else f"{e.interval[0]:.5g} … {e.interval[1]:.5g}"
        unit = unit_of(e.name)
        name = e.name if unit == "1" else f"{e.name} \\[{unit}]"
        table.add_row(name, f"{e.value:.5g}", interval, f"{e.noise_sigma:.2g}", f"{e.model_error:.2g}")
    console.print(table)
    console.print(f"Young's modulus {found.youngs_modulus:.4g} Pa, Poisson's ratio {found.poisson_ratio:.4f}")
    for sentence in (*found.identifiability.sentences, *found.warnings):
        console.print(sentence, highlight=False, markup=False)
    console.print("look at:", str(out / "fit.png"), highlight=False, soft_wrap=True)
