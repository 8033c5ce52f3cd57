"""The command `physconvex simulate`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer


def simulate_command(
    *,
    assets: Annotated[
        list[Path],
        typer.Argument(
            help="Mesh file of a closed surface, z up (glTF: y up); PLY file of a convex field; or folder of "
            "`physconvex refine`. Several assets fall one on the other, in this order.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("simulation"),
    preset: Annotated[
        str | None,
        typer.Option(help="Preset (stiff, soft, plasticine, sand, push, moving_floor) or YAML file."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change a setting, such as material.youngs_modulus=3.0e4 or floor.velocity=[1,0,0]; "
            "2:material.density=500 changes it for the second asset only; repeatable.",
        ),
    ] = None,
    youngs_modulus: Annotated[float | None, typer.Option(help="Young's modulus [Pa].")] = None,
    poisson_ratio: Annotated[float | None, typer.Option(help="Poisson's ratio.")] = None,
    density: Annotated[float | None, typer.Option(help="Density [kg/m³].")] = None,
    size: Annotated[
        float | None, typer.Option(help="Longest edge of the object [m]. Default: that of the file.")
    ] = None,
    drop_height: Annotated[
        float | None, typer.Option(help="Initial height of the lowest point above the floor [m].")
    ] = None,
    orientation: Annotated[
        tuple[float, float, float] | None, typer.Option(help="Initial rotations about x, then y, then z [degrees].")
    ] = None,
    basis: Annotated[str | None, typer.Option(help="Kind of skinning weights: eigenmodes, elastic or neural.")] = None,
    modes: Annotated[int | None, typer.Option(help="Number of skinning weights, without the constant one.")] = None,
    frames: Annotated[int | None, typer.Option(help="Number of frames; the first is at t = 0.")] = None,
    fps: Annotated[float | None, typer.Option(help="Frames per second [1/s].")] = None,
    ply: Annotated[bool, typer.Option(help="Write one PLY file per frame.")] = True,
    glb: Annotated[bool, typer.Option(help="Write animation.glb, for any glTF viewer.")] = True,
    video: Annotated[bool, typer.Option(help="Render video.mp4; needs OpenGL, but no display.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the summary, as JSON.")] = False,
    progress: Annotated[bool, typer.Option(help="Show a progress bar.")] = True,
) -> None:
    """Simulate bodies of any material that fall, are pushed or are shaken, and write their motion.

    Writes trajectory.npz, frames/*.ply, animation.glb, simulation.json and, with --video, video.mp4.
    """
    from tqdm import tqdm

    from physconvex.play.roll_out import play_together
    from physconvex.play.simulation import configure_assets
    from physconvex.play.writing import summary_of, write_played

    chosen = {
        "material.youngs_modulus": youngs_modulus,
        "material.poisson_ratio": poisson_ratio,
        "material.density": density,
        "object.size": size,
        "object.drop_height": drop_height,
        "object.orientation_deg": None if orientation is None else list(orientation),
        "basis.kind": basis,
        "basis.modes": modes,
        "time.frames": frames,
        "time.fps": fps,
    }
    overrides = [f"{name}={json.dumps(value)}" for name, value in chosen.items() if value is not None]
    objects, configs = configure_assets(assets, preset=preset, settings=[*overrides, *(settings or [])])
    quiet = as_json or not progress or not sys.stderr.isatty()
    with tqdm(total=configs[0].time.frames - 1, unit="frame", disable=quiet) as bar:
        played = play_together(objects, configs, on_frame=lambda _: bar.update())
    write_played(played, out, ply=ply, glb=glb, video=video)
    summary = {"out": str(out), **summary_of(played)}
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        typer.echo(
            f"{out}: {summary['frames']} frames of {summary['vertices']} vertices, {summary['mass_kg']:.3g} kg; height "
            f"{summary['height_first_m']:.3g} m at first, {summary['height_last_m']:.3g} m at last"
        )
