"""The options of `physconvex refine`, by what they are about: unknowns, observations, models, results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = [
    "CameraPosition",
    "CameraRotation",
    "Cameras",
    "CaptureFolder",
    "Checkpoint",
    "Colours",
    "Correction",
    "Device",
    "Drift",
    "Exposure",
    "Field",
    "FieldFile",
    "FieldSteps",
    "Fill",
    "FineNodes",
    "Fix",
    "Free",
    "FullRuns",
    "Initial",
    "Jacobian",
    "Json",
    "Kind",
    "MaxNodes",
    "ModelError",
    "NoProgress",
    "Out",
    "Outlines",
    "Pictures",
    "Prior",
    "Processes",
    "Start",
    "StepsPerFrame",
    "TimeOffset",
    "Weights",
]

_UNKNOWN, _SEEN, _MODEL, _RESULT = "Unknowns", "What was observed", "Models", "Results"

Names = list[str] | None

CaptureFolder = Annotated[
    Path, typer.Argument(help="Capture folder with capture.json, rest geometry, tracks or videos.")
]

Free = Annotated[
    Names,
    typer.Option(
        help="Free a parameter, as friction, air_drag, initial_velocity_z; repeatable.", rich_help_panel=_UNKNOWN
    ),
]
Fix = Annotated[
    Names,
    typer.Option(
        help="Hold a parameter: NAME, or NAME=VALUE, as damping_time=0; repeatable.", rich_help_panel=_UNKNOWN
    ),
]
Prior = Annotated[
    Names,
    typer.Option(
        help="Gaussian prior NAME=MEAN,SIGMA, as poisson_ratio=0.49,0.005; repeatable.", rich_help_panel=_UNKNOWN
    ),
]
Initial = Annotated[
    Names,
    typer.Option(
        help="Start at NAME=VALUE, as log10_youngs_modulus=5.2, and do not scan; repeatable.", rich_help_panel=_UNKNOWN
    ),
]
Start = Annotated[
    str,
    typer.Option(help="Where the scan looks: predict (network), scan (everywhere), auto.", rich_help_panel=_UNKNOWN),
]
Checkpoint = Annotated[str, typer.Option(help="Name or folder of the network's checkpoint.", rich_help_panel=_UNKNOWN)]

Kind = Annotated[str, typer.Option(help="auto, tracks, video or both.", rich_help_panel=_SEEN)]
Cameras = Annotated[Names, typer.Option(help="Use this camera alone; repeatable. Default: all.", rich_help_panel=_SEEN)]
Outlines = Annotated[bool, typer.Option(help="Use the masks of videos.", rich_help_panel=_SEEN)]
Colours = Annotated[
    bool,
    typer.Option(help="Last, compare colours instead of points followed in videos.", rich_help_panel=_SEEN),
]
Exposure = Annotated[
    bool, typer.Option(help="Gain and offset of each frame's colours are free.", rich_help_panel=_SEEN)
]
CameraRotation = Annotated[
    float,
    typer.Option(help="Free each camera's rotation, with this prior standard deviation [rad].", rich_help_panel=_SEEN),
]
CameraPosition = Annotated[
    float,
    typer.Option(help="Free each camera's position, with this prior standard deviation [m].", rich_help_panel=_SEEN),
]
TimeOffset = Annotated[
    float,
    typer.Option(
        help="Free the time of all frames after the first, with this prior deviation [s].", rich_help_panel=_SEEN
    ),
]

Weights = Annotated[int, typer.Option(help="Number of skinning weights of the result.", rich_help_panel=_MODEL)]
MaxNodes = Annotated[int, typer.Option(help="Most nodes of the quadratic mesh.", rich_help_panel=_MODEL)]
FineNodes = Annotated[
    int | None,
    typer.Option(
        help="Most nodes of the mesh of the last searches, of a body that strikes something; 0: the same as before; "
        "default: 2400, of a soft body 1400.",
        rich_help_panel=_MODEL,
    ),
]
Fill = Annotated[
    bool,
    typer.Option(
        help="Let mass and energy of a mesh made of the surface be those of the surface's inside.",
        rich_help_panel=_MODEL,
    ),
]
StepsPerFrame = Annotated[
    int | None,
    typer.Option(
        help="Time steps per frame. Default: 384 per second; by the body's waves where it strikes something.",
        rich_help_panel=_MODEL,
    ),
]
Correction = Annotated[
    bool, typer.Option(help="Remove the reduced model's error with the full model.", rich_help_panel=_MODEL)
]
FullRuns = Annotated[
    int, typer.Option(help="Most states of the full model that the correction tries.", rich_help_panel=_MODEL)
]
Jacobian = Annotated[
    str, typer.Option(help="Derivatives of the correction: of the full or reduced model.", rich_help_panel=_MODEL)
]
ModelError = Annotated[
    bool, typer.Option(help="Fit a finer model, and state the error that is left.", rich_help_panel=_MODEL)
]
Drift = Annotated[
    bool,
    typer.Option(
        help="Let the recording drift from the model as a rigid body after a contact.", rich_help_panel=_MODEL
    ),
]

Out = Annotated[
    Path, typer.Option(help="Folder of the results; finished stages are read again from it.", rich_help_panel=_RESULT)
]
Field = Annotated[
    bool,
    typer.Option(help="Fit a convex field to the first images and bind it to the body.", rich_help_panel=_RESULT),
]
FieldFile = Annotated[
    str | None, typer.Option(help="A field (PLY) of the body at rest, in place of that.", rich_help_panel=_RESULT)
]
FieldSteps = Annotated[int, typer.Option(help="Steps of the field's fit.", rich_help_panel=_RESULT)]
Processes = Annotated[
    int | None,
    typer.Option(help="Roll-outs made at once; as many as there are cores unless given.", rich_help_panel=_RESULT),
]
Device = Annotated[
    str,
    typer.Option(help="Torch device of the network and the field's fit, such as cpu or cuda.", rich_help_panel=_RESULT),
]
Pictures = Annotated[bool, typer.Option(help="Write fit.png and side_by_side.mp4.", rich_help_panel=_RESULT)]
Json = Annotated[
    bool, typer.Option("--json", help="Print refinement.json to standard output, alone.", rich_help_panel=_RESULT)
]
NoProgress = Annotated[bool, typer.Option("--no-progress", help="Say nothing while it runs.", rich_help_panel=_RESULT)]
