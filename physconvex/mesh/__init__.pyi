from .elements import (
    QUADRATURE as QUADRATURE,
    barycentric_gradients as barycentric_gradients,
    shape_gradients as shape_gradients,
    shape_values as shape_values,
    unit_mass as unit_mass,
)
from .embedding import (
    Embedding as Embedding,
    Places as Places,
    locate as locate,
    sample_interior as sample_interior,
)
from .filling import filled as filled
from .implicit_meshing import tetrahedralize_implicit as tetrahedralize_implicit
from .meshing import (
    TriangleSurface as TriangleSurface,
    mesh_of_few_nodes as mesh_of_few_nodes,
    shape_mismatch as shape_mismatch,
    tetrahedralize as tetrahedralize,
)
from .refinement import refine_locally as refine_locally, refine_uniformly as refine_uniformly
from .surface_fitting import with_volume as with_volume
from .surfaces import (
    enclosed_volume as enclosed_volume,
    overlap as overlap,
    surface_distance as surface_distance,
    with_fewer_triangles as with_fewer_triangles,
    with_merged_vertices as with_merged_vertices,
)
from .tet_mesh import (
    EDGE_CORNERS as EDGE_CORNERS,
    FACE_CORNERS as FACE_CORNERS,
    TetMesh as TetMesh,
    box_mesh as box_mesh,
    compact as compact,
    linear_part as linear_part,
    to_quadratic as to_quadratic,
)
