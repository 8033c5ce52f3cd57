"""The command `physconvex view`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["view_command"]


def view_command(
    field: Annotated[Path, typer.Argument(help="field.ply, or a folder with it or with one per frame.")],
    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 lets other machines in.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; the next free one if it is taken.")] = 8080,
    size: Annotated[int, typer.Option(help="Longest edge of the pictures [pixels].", min=16)] = 720,
) -> None:
    """Look at a convex field in the browser, until stopped with Ctrl-C."""
    from physconvex.render.viewer import FieldViewer, read_fields

    viewer = FieldViewer(read_fields(field), host=host, port=port, size=size)
    print(f"open {viewer.address} (Ctrl-C ends)", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        viewer.close()
