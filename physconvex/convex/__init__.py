"""The convex field: an object as soft-edged, coloured convex hulls."""

from physconvex.convex.field import ConvexField
from physconvex.convex.halfspaces import HalfSpaces, half_spaces, hull_faces, occupancy, support
from physconvex.convex.mesh import hull_mesh, write_glb
from physconvex.convex.parameters import FreeParameters
from physconvex.convex.ply import read_ply, write_ply
from physconvex.convex.spherical_harmonics import coefficients_of_colour, harmonic_basis, view_colours

__all__ = [
    "ConvexField",
    "FreeParameters",
    "HalfSpaces",
    "coefficients_of_colour",
    "half_spaces",
    "harmonic_basis",
    "hull_faces",
    "hull_mesh",
    "occupancy",
    "read_ply",
    "support",
    "view_colours",
    "write_glb",
    "write_ply",
]
