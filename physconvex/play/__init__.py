"""Play an object: from a mesh file and a description of material, forces and floor to its motion on disk."""

from physconvex.play.animated_glb import write_animated_glb
from physconvex.play.assets import Asset, read_asset
from physconvex.play.config import (
    BasisConfig,
    ContactConfig,
    FloorConfig,
    ForceConfig,
    MaterialConfig,
    ObjectConfig,
    PlayConfig,
    TimeConfig,
    load_play_config,
    overrides_of,
)
from physconvex.play.fields import frames_of_field, moving_fields, moving_half_spaces
from physconvex.play.pictures import frames_of
from physconvex.play.play import PlayedObject, play, play_together
from physconvex.play.surface import RestSurface, read_surface
from physconvex.play.writing import write_played

__all__ = [
    "Asset",
    "BasisConfig",
    "ContactConfig",
    "FloorConfig",
    "ForceConfig",
    "MaterialConfig",
    "ObjectConfig",
    "PlayConfig",
    "PlayedObject",
    "RestSurface",
    "TimeConfig",
    "frames_of",
    "frames_of_field",
    "load_play_config",
    "moving_fields",
    "moving_half_spaces",
    "overrides_of",
    "play",
    "play_together",
    "read_asset",
    "read_surface",
    "write_animated_glb",
    "write_played",
]
