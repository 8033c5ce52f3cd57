from .coarse_mesh import faithful_mesh as faithful_mesh, unfaithfulness as unfaithfulness
from .elements import (
    QUADRATURE as QUADRATURE,
    shape_gradients as shape_gradients,
    shape_values as shape_values,
    unit_mass as unit_mass,
)
from .embedding import (
    Embedding as Embedding,
    locate as locate,
    sample_interior as sample_interior,
)
from .filling import filled as filled
from .implicit_meshing import tetrahedralize_implicit as tetrahedralize_implicit
from .local_refinement import refine_locally as refine_locally
from .meshing import TriangleSurface as TriangleSurface, tetrahedralize as tetrahedralize
from .signed_distance import merged as merged, overlap as overlap, surface_distance as surface_distance
from .tet_mesh import (
    EDGE_CORNERS as EDGE_CORNERS,
    FACE_CORNERS as FACE_CORNERS,
    TetMesh as TetMesh,
    box_mesh as box_mesh,
    compact as compact,
    linear_part as linear_part,
    refine_uniformly as refine_uniformly,
    to_quadratic as to_quadratic,
)
from .volume import enclosed_volume as enclosed_volume, with_volume as with_volume
