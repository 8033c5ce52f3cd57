"""Simulate assets from files: the Python equivalent of the command `physconvex simulate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from physconvex.dynamics import State
from physconvex.errors import InputError
from physconvex.play.assets import Asset, read_asset
from physconvex.play.config import PlayConfig, load_play_config, overrides_of
from physconvex.play.roll_out import PlayedObject, play_together
from physconvex.play.writing import write_played


def simulate_assets(
    assets: str | Path | Asset | Sequence[str | Path | Asset],
    *,
    preset: str | Path | None = None,
    settings: Sequence[str] = (),
    out: str | Path | None = None,
    ply: bool = True,
    glb: bool = True,
    video: bool = False,
    on_frame: Callable[[State], None] | None = None,
) -> PlayedObject:
    """Drop, push or shake one object or several of any material; `physconvex simulate` as a function.

    Args:
        assets: mesh file of a closed surface (z up; glTF: y up), PLY file of a convex field, folder of
            `physconvex refine`, or what `physconvex.play.read_asset` returns. Several are played together, each dropped
            on the one before it.
        preset: stiff, soft, plasticine, sand, push, moving_floor, or a YAML file of the same form; None: an elastic
            body of E = 0.1 MPa.
        settings: overrides such as "material.youngs_modulus=3.0e4", or "2:material.density=500" for the second asset.
        out: folder of the results (`physconvex.play.write_played`); None: nothing is written.
        ply: write one PLY file per frame.
        glb: write animation.glb.
        video: render video.mp4, which needs OpenGL but no display.
        on_frame: called with the state at every finished frame.

    Returns:
        The surfaces in motion: `positions` [m], shape [T, V, 3], with `trajectories` of the reduced bodies.

    Raises:
        InputError: a file or a setting is wrong; the message names it, the cause and the remedy.
        ConvergenceError: a time step failed.
    """
    objects, configs = configure_assets(assets, preset=preset, settings=settings)
    played = play_together(objects, configs, on_frame=on_frame)
    if out is not None:
        write_played(played, out, ply=ply, glb=glb, video=video)
    return played


def configure_assets(
    assets: str | Path | Asset | Sequence[str | Path | Asset],
    *,
    preset: str | Path | None = None,
    settings: Sequence[str] = (),
) -> tuple[list[Asset], list[PlayConfig]]:
    """The assets, read, and the configuration of each; arguments of `simulate_assets`."""
    if isinstance(settings, str | Mapping):
        raise InputError(f'settings: got {settings!r}; expected a list of texts, as ["material.density=500"]')
    given = [assets] if isinstance(assets, str | Path | Asset) else list(assets)
    objects = [asset if isinstance(asset, Asset) else read_asset(asset) for asset in given]
    configs = [
        load_play_config(preset, overrides=overrides_of(number, len(objects), settings), found=asset.settings)
        for number, asset in enumerate(objects, start=1)
    ]
    return objects, configs
