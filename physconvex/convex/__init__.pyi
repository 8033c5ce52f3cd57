from .adaptation import (
    AdaptedField as AdaptedField,
    adapt_to_motion as adapt_to_motion,
    bent_frames as bent_frames,
)
from .field import ConvexField as ConvexField, FreeParameters as FreeParameters
from .files import hull_mesh as hull_mesh, read_ply as read_ply, write_glb as write_glb, write_ply as write_ply
from .halfspaces import (
    HalfSpaces as HalfSpaces,
    half_spaces as half_spaces,
    hull_faces as hull_faces,
    occupancy as occupancy,
)
from .merging import merge as merge
from .motion import (
    BoundField as BoundField,
    DeformationMap as DeformationMap,
    advect as advect,
    affine_map as affine_map,
    bind_to_space as bind_to_space,
    bind_to_tets as bind_to_tets,
    polar_rotation as polar_rotation,
    space_map as space_map,
    tet_map as tet_map,
)
from .solidity import (
    inside_union as inside_union,
    occupancies as occupancies,
    union_samples as union_samples,
    union_volume as union_volume,
)
from .spherical_harmonics import (
    coefficients_of_colour as coefficients_of_colour,
    harmonic_basis as harmonic_basis,
    rotate_harmonics as rotate_harmonics,
    view_colours as view_colours,
)
from .splitting import (
    Division as Division,
    halve as halve,
    non_affinity as non_affinity,
    split as split,
    split_until_affine as split_until_affine,
)
from .surface_motion import move_half_spaces as move_half_spaces, points_of_half_spaces as points_of_half_spaces
