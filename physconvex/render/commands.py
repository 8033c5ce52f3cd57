"""The commands `physconvex film` and `physconvex view`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated

import typer


def film_command(
    field: Annotated[Path, typer.Argument(help="File field.ply, or a folder with it or with one PLY file per frame.")],
    *,
    out: Annotated[Path, typer.Option(help="Video file (.mp4), or picture file (.png) of the first frame.")] = Path(
        "film.mp4"
    ),
    size: Annotated[int, typer.Option(help="Width and height of the pictures [pixels]; an even number.", min=16)] = 448,
    frames: Annotated[
        int, typer.Option(help="Frames of one turn of the camera, if the field does not move.", min=1)
    ] = 48,
    fps: Annotated[float, typer.Option(help="Frames per second.")] = 24.0,
    elevation: Annotated[float, typer.Option(help="Elevation of the camera above the horizon [degrees].")] = 20.0,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="Hide the progress bar.")] = False,
) -> None:
    """Render a convex field as a film or a picture: a turntable, or the motion of a moving field."""
    from PIL import Image
    from tqdm import tqdm

    from physconvex.convex import ConvexField
    from physconvex.errors import InputError
    from physconvex.io import write_video
    from physconvex.render.movies import film as draw, orbit
    from physconvex.render.viewer import read_fields

    if out.suffix not in (".mp4", ".png"):
        raise InputError(f"out: got {out.name!r}; expected a name that ends in .mp4 or .png")
    fields = [one for _, one in read_fields(field)]
    every = ConvexField.joined(fields)
    still = len(fields) == 1
    cameras = orbit(every, frames if still else 1, width=size, height=size, elevation_deg=elevation)
    pictures = draw(fields * len(cameras), cameras * len(fields))
    if out.suffix == ".png":
        Image.fromarray(next(pictures)).save(out)
        return
    shown = not no_progress and sys.stderr.isatty()
    watched = tqdm(pictures, total=len(cameras) * len(fields), unit="frame", disable=not shown, leave=False)
    write_video(out, iter(watched), fps=fps)


def view_command(
    field: Annotated[Path, typer.Argument(help="File field.ply, or a folder with it or with one PLY file per frame.")],
    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 accepts other machines.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; if it is taken, the next free one.")] = 8080,
    size: Annotated[int, typer.Option(help="Longest edge of the pictures [pixels].", min=16)] = 720,
) -> None:
    """Show a convex field in the browser until Ctrl-C."""
    from physconvex.render.viewer import FieldViewer, read_fields

    viewer = FieldViewer(read_fields(field), host=host, port=port, size=size)
    print(f"open {viewer.address} (Ctrl-C ends)", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        viewer.close()
