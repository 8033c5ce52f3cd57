"""The command `physconvex simulate`."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from pydantic import Field

from physconvex.io import CommandLine, Options, command

if TYPE_CHECKING:
    from physconvex.play import Asset

_PLACES = {
    "youngs_modulus": "material.youngs_modulus",
    "poisson_ratio": "material.poisson_ratio",
    "density": "material.density",
    "size": "object.size",
    "drop_height": "object.drop_height",
    "orientation": "object.orientation_deg",
    "basis": "basis.kind",
    "basis_file": "basis.file",
    "modes": "basis.modes",
    "frames": "time.frames",
    "fps": "time.fps",
}


class SimulateOptions(Options):
    """What is played, and what is written of it."""

    preset: str | None = None
    """Preset (stiff, soft, plasticine, sand, push, moving_floor) or YAML file."""
    settings: Annotated[tuple[str, ...], CommandLine("--set")] = Field(
        default=(),
        description="Change a setting, such as material.youngs_modulus=3.0e4 or floor.velocity=[1,0,0]; "
        "2:material.density=500 changes it for the second asset only; repeatable.",
    )
    youngs_modulus: float | None = None
    """Young's modulus [Pa]."""
    poisson_ratio: float | None = None
    """Poisson's ratio."""
    density: float | None = None
    """Density [kg/m³]."""
    size: float | None = None
    """Longest edge of the object [m]. Default: that of the file."""
    drop_height: float | None = None
    """Initial height of the lowest point above the floor [m]."""
    orientation: tuple[float, float, float] | None = None
    """Initial rotations about x, then y, then z [degrees]."""
    basis: str | None = None
    """Kind of skinning weights: eigenmodes, elastic, neural or predicted."""
    basis_file: str | None = None
    """Predicted weights: clips/NAME.skinning.safetensors of `physconvex predict`."""
    modes: int | None = None
    """Number of skinning weights, without the constant one."""
    frames: int | None = None
    """Number of frames; the first is at t = 0."""
    fps: float | None = None
    """Frames per second [1/s]."""
    ply: bool = True
    """Write one PLY file per frame."""
    glb: bool = True
    """Write animation.glb, for any glTF viewer."""
    video: bool = False
    """Render video.mp4; needs OpenGL, but no display."""

    @property
    def overrides(self) -> list[str]:
        """All settings as `section.name=value`; those of `settings` come last."""
        given = {place: getattr(self, name) for name, place in _PLACES.items()}
        return [f"{place}={json.dumps(v)}" for place, v in given.items() if v is not None] + list(self.settings)


@command
def simulate_command(
    *,
    assets: Annotated[
        list[Path],
        typer.Argument(
            help="Mesh file of a closed surface, z up (glTF: y up); PLY file of a convex field; capture folder; or "
            "folder of `physconvex reconstruct` or `physconvex refine`. Several assets fall one on the other, in this "
            "order.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("simulation"),
    options: SimulateOptions,
    body: Annotated[
        Path | None,
        typer.Option(
            help="Mesh of the closed surface [m] that moves in place of the asset's own; a convex field goes with it. "
            "For one asset."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the summary, as JSON.")] = False,
    progress: Annotated[bool, typer.Option(help="Show a progress bar.")] = True,
) -> None:
    """Simulate bodies of any material that fall, are pushed or are shaken, and write their motion.

    Writes trajectory.npz, frames/*.ply, animation.glb, simulation.json and, with --video, video.mp4. The body of a
    capture without a mesh is reconstructed first, in OUT/reconstruction; this can be stopped, and is done once.
    """
    from tqdm import tqdm

    from physconvex import InputError
    from physconvex.play import configure_assets, play_together, summary_of, write_played

    if body is not None and len(assets) > 1:
        raise InputError(f"body (--body): got {len(assets)} assets; expected one, whose surface it replaces")
    quiet = as_json or not progress or not sys.stderr.isatty()
    found = []
    for number, path in enumerate(assets, start=1):
        folder = out / f"asset_{number}" if len(assets) > 1 else out
        found.append(_asset(path, folder, body, told=progress))
    objects, configs = configure_assets(found, preset=options.preset, settings=options.overrides)
    with tqdm(total=configs[0].time.frames - 1, unit="frame", disable=quiet) as bar:
        played = play_together(objects, configs, on_frame=lambda _: bar.update())
    write_played(played, out, ply=options.ply, glb=options.glb, video=options.video)
    summary = {"out": str(out), **summary_of(played)}
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        typer.echo(
            f"{out}: {summary['frames']} frames of {summary['vertices']} vertices, {summary['mass_kg']:.3g} kg; height "
            f"{summary['height_first_m']:.3g} m at first, {summary['height_last_m']:.3g} m at last"
        )
        for field in played.adapted:
            if field is not None and field.split > field.given:
                typer.echo(f"convexes that the motion bends are split: {field}")


def _asset(path: Path, out: Path, body: Path | None, *, told: bool) -> Asset:
    """What moves: of a capture its surface and density; its convex field, if it is reconstructed in `out`."""
    from physconvex.io import CAPTURE_FILE, load_capture
    from physconvex.play import Asset, RestSurface, read_asset, read_surface

    if not (path / CAPTURE_FILE).is_file():
        asset = read_asset(path)
        return asset if body is None else replace(asset, surface=read_surface(body), overlapping=False)

    from inference.rest_geometry import rest_geometry_of
    from physconvex.identify import surface_of_capture
    from physconvex.mesh import with_merged_vertices

    def say(stage: str, stored: bool) -> None:
        if told:
            note = " (read again)" if stored else " …"
            print(f"physconvex simulate: {path}: {stage}{note}", file=sys.stderr, flush=True)

    capture, made = rest_geometry_of(load_capture(path), body=body, out=out, on_stage=say)
    surface = surface_of_capture(capture)
    assert surface is not None
    return Asset(
        RestSurface(*with_merged_vertices(*surface)),
        None if made is None else made.field,
        settings={"material": {"density": capture.density}},
    )
