"""The command `physconvex film`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["film_command"]


def film_command(
    field: Annotated[Path, typer.Argument(help="field.ply, or a folder with it or with one per frame.")],
    out: Annotated[Path, typer.Option(help="film.mp4, or picture.png for the first frame.")] = Path("film.mp4"),
    size: Annotated[int, typer.Option(help="Edge of the pictures [pixels], even.", min=16)] = 448,
    frames: Annotated[int, typer.Option(help="Frames once round a field that does not move.", min=1)] = 48,
    fps: Annotated[float, typer.Option(help="Frames per second.")] = 24.0,
    elevation: Annotated[float, typer.Option(help="Of the camera above the horizon [degrees].")] = 20.0,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="No progress bar.")] = False,
) -> None:
    """Draw a convex field seen from all round, or one that moves, as a film or a picture."""
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
