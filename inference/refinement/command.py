"""The command `physconvex refine`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from inference.refinement import command_options as has
from physconvex import InputError

__all__ = ["refine"]

_STAGES = {
    "points": "following points in the videos",
    "scan": "scanning Young's modulus",
    "reduced": "fitting the reduced model",
    "coarse": "fitting the full model on few nodes",
    "drift_limit": "bounding rigid drift by two meshes",
    "drift": "looking for rigid drift after a contact",
    "start": "comparing starts",
    "frame_errors": "comparing few nodes with more",
    "anchored": "following the points again from the model",
    "reduced_again": "fitting the reduced model again",
    "correction": "correcting with the full model",
    "fine": "fitting on more nodes",
    "fine_mesh": "making a mesh of more nodes",
    "colours": "comparing colours",
    "field": "fitting a convex field to the first images",
    "model_error": "finer model, for the error that is left",
    "motion": "predicting all frames",
}


def refine(
    capture: has.CaptureFolder,
    out: has.Out = Path("refinement"),
    observations: has.Kind = "auto",
    camera: has.Cameras = None,
    outlines: has.Outlines = True,
    colours: has.Colours = True,
    exposure: has.Exposure = True,
    camera_rotation: has.CameraRotation = 0.0,
    camera_position: has.CameraPosition = 0.0,
    time_offset: has.TimeOffset = 0.0,
    free: has.Free = None,
    fix: has.Fix = None,
    prior: has.Prior = None,
    initial: has.Initial = None,
    start: has.Start = "auto",
    checkpoint: has.Checkpoint = "default",
    weights: has.Weights = 20,
    max_nodes: has.MaxNodes = 500,
    fine_nodes: has.FineNodes = None,
    steps_per_frame: has.StepsPerFrame = None,
    fill: has.Fill = True,
    correction: has.Correction = True,
    full_runs: has.FullRuns = 8,
    jacobian: has.Jacobian = "full",
    model_error: has.ModelError = True,
    drift: has.Drift = True,
    field: has.Field = True,
    field_file: has.FieldFile = None,
    field_steps: has.FieldSteps = 150,
    processes: has.Processes = None,
    device: has.Device = "cpu",
    pictures: has.Pictures = True,
    as_json: has.Json = False,
    no_progress: has.NoProgress = False,
) -> None:
    """Identify E, ν and what else is unknown of a capture with the differentiable simulator, and predict its future.

    Writes refinement.json, trajectory.npz, fit.png, side_by_side.mp4 and run.json. Stop it at any time: the same
    command goes on after the last finished stage.
    """
    from inference.refinement.options import RefineOptions
    from inference.refinement.pipeline import refine as run_refine
    from inference.refinement.result_files import write_refinement
    from physconvex.identify import Nuisance

    options = RefineOptions(
        observations=observations,  # type: ignore[arg-type]
        cameras=tuple(camera) if camera else None,
        weights=weights,
        max_nodes=max_nodes,
        fine_nodes=fine_nodes,
        steps_per_frame=steps_per_frame,
        fill=fill,
        free=tuple(free or ()),
        fixed=dict(_assignment(text) for text in fix or ()),
        priors=dict(_prior(text) for text in prior or ()),
        initial=dict(_value(text) for text in initial or ()),
        start=start,  # type: ignore[arg-type]
        correction=correction,
        full_runs=full_runs,
        jacobian=jacobian,  # type: ignore[arg-type]
        model_error=model_error,
        drift=drift,
        outlines=outlines,
        colours=colours,
        exposure=exposure,
        field=field,
        field_file=field_file,
        field_steps=field_steps,
        nuisance=Nuisance(camera_rotation, camera_position, time_offset),
        checkpoint=checkpoint,
        processes=processes or os.cpu_count() or 1,
        device=device,
    )

    def say(stage: str, stored: bool) -> None:
        if not no_progress:
            note = " (read again)" if stored else " …"
            told = _STAGES.get(stage) or _STAGES.get(stage.partition("_")[0], stage)
            print(f"physconvex refine: {told}{note}", file=sys.stderr, flush=True)

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

    from inference.refinement.result import unit_of

    console, table = Console(), Table()
    for column in ("parameter", "value", "90 % interval", "noise σ", "model error"):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    for e in found.estimates:
        interval = "none" if e.interval is None else f"{e.interval[0]:.5g} … {e.interval[1]:.5g}"
        unit = unit_of(e.name)
        name = e.name if unit == "1" else f"{e.name} \\[{unit}]"
        table.add_row(name, f"{e.value:.5g}", interval, f"{e.noise_sigma:.2g}", f"{e.model_error:.2g}")
    console.print(table)
    console.print(f"Young's modulus {found.youngs_modulus:.4g} Pa, Poisson's ratio {found.poisson_ratio:.4f}")
    for sentence in (*found.identifiability.sentences, *found.warnings):
        console.print(sentence, highlight=False, markup=False)
    console.print("look at:", str(out / "fit.png"), highlight=False, soft_wrap=True)
