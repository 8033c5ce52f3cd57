"""Play an object: from a mesh file and a description of material, forces and floor to its motion on disk."""

from physconvex.play.animated_glb import write_animated_glb
from physconvex.play.config import (
    BasisConfig,
    FloorConfig,
    ForceConfig,
    MaterialConfig,
    ObjectConfig,
    PlayConfig,
    TimeConfig,
    load_play_config,
)
from physconvex.play.pictures import frames_of
from physconvex.play.play import PlayedObject, play
from physconvex.play.surface import RestSurface, read_surface
from physconvex.play.writing import write_played

__all__ = [
    "BasisConfig",
    "FloorConfig",
    "ForceConfig",
    "MaterialConfig",
    "ObjectConfig",
    "PlayConfig",
    "PlayedObject",
    "RestSurface",
    "TimeConfig",
    "frames_of",
    "load_play_config",
    "play",
    "read_surface",
    "write_animated_glb",
    "write_played",
]
