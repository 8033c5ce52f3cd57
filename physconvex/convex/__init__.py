"""The convex field: an object as soft-edged, coloured convex hulls."""

from physconvex.convex.field import ConvexField
from physconvex.convex.halfspaces import HalfSpaces, half_spaces, hull_faces, occupancy, support
from physconvex.convex.halving import halve
from physconvex.convex.merging import merge
from physconvex.convex.mesh import hull_mesh, write_glb
from physconvex.convex.motion import (
    BoundField,
    DeformationMap,
    advect,
    affine_map,
    bind_to_space,
    bind_to_tets,
    space_map,
    tet_map,
)
from physconvex.convex.parameters import FreeParameters
from physconvex.convex.ply import read_ply, write_ply
from physconvex.convex.rotation import polar_rotation, rotate_harmonics
from physconvex.convex.solidity import hull_volumes, inside_union, occupancies, union_volume
from physconvex.convex.spherical_harmonics import coefficients_of_colour, harmonic_basis, view_colours
from physconvex.convex.splitting import Division, non_affinity, split, split_until_affine
from physconvex.convex.surface_motion import move_half_spaces, points_of_half_spaces

__all__ = [
    "BoundField",
    "ConvexField",
    "DeformationMap",
    "Division",
    "FreeParameters",
    "HalfSpaces",
    "advect",
    "affine_map",
    "bind_to_space",
    "bind_to_tets",
    "coefficients_of_colour",
    "half_spaces",
    "halve",
    "harmonic_basis",
    "hull_faces",
    "hull_mesh",
    "hull_volumes",
    "inside_union",
    "merge",
    "move_half_spaces",
    "non_affinity",
    "occupancies",
    "occupancy",
    "points_of_half_spaces",
    "polar_rotation",
    "read_ply",
    "rotate_harmonics",
    "space_map",
    "split",
    "split_until_affine",
    "support",
    "tet_map",
    "union_volume",
    "view_colours",
    "write_glb",
    "write_ply",
]
